"""The documentation compared with the code: links, examples, and all required names."""

import ast
import dataclasses
import json
import re
import runpy
import shlex
import subprocess
import sys
import typing
from textwrap import dedent

import pytest
from doc_pages import PAGES, ROOT, name_of, text_of
from pydantic import BaseModel

from marl_lanes import Scenario, load_scenario
from marl_lanes.cli.arguments import EXAMPLES
from marl_lanes.cli.main import make_parser
from marl_lanes.evaluation.benchmark_tables import (
    BEGIN,
    COMFORT,
    END,
    OUTCOMES,
    format_markdown,
    read_rows,
)
from marl_lanes.evaluation.metrics import summarise
from marl_lanes.recipes.naf import DESCRIPTION
from marl_lanes.traffic.roles.changer import FEATURES
from marl_lanes.training.algorithms.naf import TrainingConfig
from marl_lanes.training.checkpoint import make_network, save_checkpoint
from marl_lanes.trajectory.columns import COLUMNS

DOCS = ROOT / "docs"
API = ROOT / "tests" / "public_api.txt"
LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
IMAGE = re.compile(r"!\[[^\]]+\]\(([^)\s]+)\)|<img [^>]*src=\"([^\"]+)\"")
BLOCK = re.compile(r"^```python\n(.*?)^```", re.DOTALL | re.MULTILINE)


def anchors(path):
    """The anchors of a page's headings."""
    heads = re.findall(r"^#+ (.*)$", text_of(path), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}


BLOCKS = {page: BLOCK.findall(text_of(page)) for page in PAGES if BLOCK.search(text_of(page))}

RUN_BLOCKS = """
import json, os, runpy, traceback
from pathlib import Path

faults = {}
for folder in json.loads(Path("folders.json").read_text(encoding="utf-8")):
    os.chdir(folder)
    for block in sorted(Path().glob("block_*.py")):
        try:
            runpy.run_path(str(block), run_name="__main__")
        except Exception:
            faults.setdefault(folder, traceback.format_exc())
    os.chdir("..")
    faults.setdefault(folder, None)
Path("faults.json").write_text(json.dumps(faults), encoding="utf-8")
"""


@pytest.fixture(scope="module")
def faults(tmp_path_factory):
    """What went wrong in each page's blocks, or None: in order, each with its own names.

    All pages are in one process, which imports the packages once, each in a folder of its own.
    """
    folder = tmp_path_factory.mktemp("pages")
    network = make_network(load_scenario("paper"), "cascade")
    for number, blocks in enumerate(BLOCKS.values()):
        # What the page on training reads: a checkpoint of a trained policy.
        path = folder / str(number) / "runs" / "paper" / "checkpoints" / "final.pt"
        save_checkpoint(path, network, "paper", 0)
        for index, block in enumerate(blocks):
            (folder / str(number) / f"block_{index}.py").write_text(block, encoding="utf-8")
    (folder / "folders.json").write_text(json.dumps([str(n) for n in range(len(BLOCKS))]))
    command = [sys.executable, "-c", RUN_BLOCKS]
    done = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, timeout=600, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    found = json.loads((folder / "faults.json").read_text(encoding="utf-8"))
    return dict(zip(BLOCKS, found.values(), strict=True))


def names(page):
    """The words in backticks in the first column of the page's tables."""
    rows = re.findall(r"^\|([^|]*)\|", text_of(page), re.MULTILINE)
    return [re.findall(r"`([^`]+)`", row) for row in rows if "`" in row]


def scenario_fields(kind=Scenario, prefix=""):
    """Dotted names of the schema: [] for entries of lists, * for entries of maps."""
    for name, field in kind.model_fields.items():
        inner = field.annotation
        origin, arguments = typing.get_origin(inner), typing.get_args(inner)
        entry = next((one for one in arguments if isinstance(one, type)), None)
        section = next(
            (
                one
                for one in (inner, *arguments)
                if isinstance(one, type) and issubclass(one, BaseModel)
            ),
            None,
        )
        if section is None or origin is not None:
            assert entry is None or origin is not None
            yield prefix + name
        if section is not None:
            mark = {dict: ".*.", tuple: "[]."}.get(origin, ".")
            yield from scenario_fields(section, prefix + name + mark)


def training_fields(kind=TrainingConfig, prefix=""):
    for name, field in kind.model_fields.items():
        inner = field.annotation
        if isinstance(inner, type) and issubclass(inner, BaseModel):
            yield from training_fields(inner, f"{prefix}{name}.")
        else:
            yield prefix + name


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_relative_link_leads_somewhere(page):
    for link in LINK.findall(text_of(page)):
        if re.match(r"[a-z]+:", link):
            continue
        name, _, anchor = link.partition("#")
        target = (page.parent / name).resolve() if name else page
        assert target.is_relative_to(ROOT), link
        assert target.exists(), link
        if anchor:
            assert anchor in anchors(target), link


def test_every_picture_is_an_image_that_make_draws():
    text = text_of(ROOT / "Makefile")
    rules = (text.partition(f"\n{name}:")[2] for name in ("figures", "reproduction"))
    makefile = "".join(rule.partition("\n\n")[0] for rule in rules)
    starts = {".svg": b"<?xml", ".png": b"\x89PNG", ".gif": b"GIF8", ".webp": b"RIFF"}
    drawn = set(re.findall(r"docs/figures/[\w.-]+", makefile))
    shown = set()
    for page in PAGES:
        for link, source in IMAGE.findall(text_of(page)):
            path = (page.parent / (link or source)).resolve()
            shown.add(path.relative_to(ROOT).as_posix())
    assert shown
    assert shown <= drawn
    assert {path.relative_to(ROOT).as_posix() for path in (DOCS / "figures").iterdir()} == drawn
    for name in drawn:
        path = ROOT / name
        assert path.read_bytes().startswith(starts[path.suffix]), name


@pytest.mark.slow
def test_the_drawing_of_a_life_has_its_phases(tmp_path):
    path = tmp_path / "life.svg"
    runpy.run_path(str(DOCS / "programs" / "life.py"))["main"](["--figure", str(path)])
    # Above, as a box; below, as a stretch of the example, which aborts and then completes.
    for phase in ("waiting", "engaged", "aborting"):
        assert text_of(path).count(f">{phase}</text>") == 2, phase


@pytest.mark.slow
def test_the_drawing_of_curves_has_the_success_beside_the_return(tmp_path):
    files = [tmp_path / "first.csv", tmp_path / "second.csv"]
    for file in files:
        file.write_text("num_steps,return,completed\n0,-16.5,0\n512,-6.25,0.75\n", encoding="utf-8")
    path = tmp_path / "curves.svg"
    program = runpy.run_path(str(DOCS / "programs" / "curves.py"))
    program["main"]([*map(str, files), "--figure", str(path)])
    for text in ("first", "second", "mean return of a command", "commands completed"):
        assert text_of(path).count(f">{text}</text>") == 1, text


def test_the_pages_are_found_and_linked_from_their_index():
    assert len(PAGES) > 8
    linked = {link.partition("#")[0] for link in LINK.findall(text_of(DOCS / "README.md"))}
    names = {page.relative_to(DOCS).as_posix() for page in DOCS.rglob("*.md")} - {"README.md"}
    assert names <= linked


def test_every_page_is_in_the_navigation_of_the_site():
    navigation = text_of(ROOT / "mkdocs.yml").partition("\nnav:\n")[2]
    # README.md is that of the repository; pages of docs/ are without the folder's name.
    paths = {name_of(page) for page in PAGES} - {"docs/README.md"}
    named = re.findall(r"[\w/-]+\.md$", navigation, re.MULTILINE)
    assert sorted(named) == sorted(path.removeprefix("docs/") for path in paths)


COMMAND = re.compile(r"^(?:    )?(marl-lanes|python|pip) .*$", re.MULTILINE)


@pytest.mark.parametrize("name", ["README.md", "CONTRIBUTING.md", "docs/tutorial.md"])
def test_a_newcomer_can_type_the_commands(name):
    """Without an activated environment, what make has installed is in .venv/bin alone."""
    found = [match[0] for match in COMMAND.finditer(text_of(ROOT / name))]
    assert found == []
    typed = re.findall(r"^(?:    )?(make|\.venv/bin/\S+) (\S+)", text_of(ROOT / name), re.MULTILINE)
    assert typed
    targets = set(re.findall(r"^([a-z-]+):", text_of(ROOT / "Makefile"), re.MULTILINE))
    commands = set(re.findall(r"^marl-lanes (\S+) ", text_of(API), re.MULTILINE))
    for program, argument in typed:
        known = {"make": targets, ".venv/bin/marl-lanes": commands}.get(program)
        if known is not None:
            assert argument in known, f"{program} {argument}"
        else:
            assert program == ".venv/bin/python"
            assert argument.startswith("-") or (ROOT / argument).is_file(), argument


@pytest.mark.slow
@pytest.mark.parametrize("page", BLOCKS, ids=name_of)
def test_every_example_runs(page, faults):
    assert faults[page] is None


def test_the_page_of_commands_has_the_examples_of_every_help():
    parser = make_parser()
    (commands,) = (one.choices for one in parser._actions if isinstance(one.choices, dict))
    page = text_of(DOCS / "commands.md")
    blocks = "".join(re.findall(r"^```sh\n(.*?)^```", page, re.DOTALL | re.MULTILINE))
    told = [line for line in blocks.replace("\\\n   ", "").splitlines() if line]
    texts = [one.epilog.removeprefix(EXAMPLES) for one in commands.values() if one.epilog]
    texts.append(DESCRIPTION.partition("examples:\n")[2].replace("%(prog)s", "marl-lanes train"))
    examples = "\n".join(map(dedent, texts)).replace("\\\n   ", "").splitlines()
    assert len(examples) > 40
    assert set(filter(None, examples)) <= set(told)
    for line in told:
        program, *arguments = shlex.split(re.split(r" [|>] | >> ", line)[0])
        assert program == "marl-lanes"
        assert parser.parse_args(arguments).run


def test_every_metric_is_documented():
    documented = set()
    for cells in names(DOCS / "metrics.md"):
        # `mean_`, `max_peak_x` stands for mean_peak_x and max_peak_x.
        if cells[0] == "mean_":
            documented |= {cells[1], "mean_" + cells[1].removeprefix("max_")}
        else:
            documented |= set(cells)
    measured = set(summarise([lane_change()]))
    assert len(measured) > 25
    assert documented == measured


def test_the_tables_of_the_benchmark_are_of_its_rows():
    rows = [row for path in sorted(DOCS.glob("benchmark/*.json")) for row in read_rows(path)]
    assert rows
    page = text_of(DOCS / "benchmark.md")
    hint = "marl-lanes benchmark-table docs/benchmark/*.json --page docs/benchmark.md"
    assert page.partition(BEGIN)[2].partition(END)[0].strip() == format_markdown(rows), hint


def test_every_statistic_of_the_benchmark_is_explained():
    page = text_of(DOCS / "benchmark.md")
    meanings = page.partition("## Metrics")[2].partition("\n## ")[0]
    explained = set(", ".join(re.findall(r"^\| ([^|]+) \|", meanings, re.MULTILINE)).split(", "))
    titles = {title.partition(" [")[0] for _, title, _, _ in (*OUTCOMES, *COMFORT)}
    assert titles <= explained


def test_every_column_of_a_trajectory_is_documented():
    rows = re.findall(
        r"^\| `([^`]+)` \| [^|]* \| ([^|]*) \| (.*) \|$",
        text_of(DOCS / "trajectories.md"),
        re.MULTILINE,
    )
    assert rows == [(column.name, column.unit, column.meaning) for column in COLUMNS]


def test_every_module_has_its_sentence():
    page = text_of(DOCS / "architecture.md").partition("## Modules")[2].partition("\n## ")[0]
    told = {}
    for section in page.split("### `")[1:]:
        folder, _, rest = section.partition("/`\n\n")
        told[f"{folder}/__init__.py"] = rest.partition("\n")[0]
        rows = re.findall(r"^\| `([^`]+)` \| (.*) \|$", rest, re.MULTILINE)
        told |= {f"{folder}/{name}": sentence for name, sentence in rows}
    wanted = {}
    for path in (ROOT / "marl_lanes").rglob("*.py"):
        docstring = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8")))
        sentence = str(docstring).partition("\n\n")[0].replace("\n", " ")
        wanted[path.relative_to(ROOT).as_posix()] = sentence
    assert told == wanted


def lane_change():
    """Metrics of one maneuver; only their names are used."""
    from marl_lanes.evaluation.measures import STEERING_COSTS, AftermathMetrics, ManeuverMetrics
    from marl_lanes.evaluation.safety import SafetyMetrics
    from marl_lanes.traffic.machine.state import Outcome

    def zeros(kind):
        return {field.name: 0.0 for field in dataclasses.fields(kind)}

    safety, after = (
        SafetyMetrics(**zeros(SafetyMetrics)),
        AftermathMetrics(**zeros(AftermathMetrics)),
    )
    returns = dict.fromkeys(STEERING_COSTS, 0.0)
    parts = {"outcome": Outcome.COMPLETED, "returns": returns, "safety": safety, "after": after}
    return ManeuverMetrics(**(zeros(ManeuverMetrics) | parts))


def test_every_scenario_field_is_documented():
    rows = {cells[0] for cells in names(DOCS / "scenarios.md")}
    shipped = {path.stem for path in (ROOT / "scenarios").glob("*.yaml")}
    fields = list(scenario_fields())
    assert {"name", "road.arcs[].radius", "drivers.profiles.*.exponent", "gap.time_gap"} <= set(
        fields
    )
    assert rows == set(fields) | shipped


def test_every_feature_is_documented():
    page = text_of(DOCS / "observations-and-actions.md")
    section = page.partition("## Features")[2].partition("\n## ")[0]
    rows = re.findall(r"^\|([^|]*)\|", section, re.MULTILINE)
    documented = {name for row in rows for name in re.findall(r"`([^`]+)`", row)}
    assert documented == {feature.name for feature in FEATURES}
    assert len(documented) == 19
    marked = [re.findall(r"`([^`]+)` \*", row) for row in rows]
    paper = load_scenario("paper").observation.features
    assert [name for cells in marked for name in cells] == list(paper)


def test_every_training_field_is_documented():
    page = text_of(DOCS / "training.md")
    section = page.partition("## Configuration")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| `([^`]+)` \|", section, re.MULTILINE)
    assert sorted(rows) == sorted(training_fields())
