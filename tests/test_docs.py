"""The documentation compared with the code: links, examples, and all required names."""

import ast
import dataclasses
import re
import shlex
import subprocess
import sys
import typing
from pathlib import Path
from textwrap import dedent

import pytest
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

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = [
    *(ROOT / f"{name}.md" for name in ("README", "CHANGELOG", "SECURITY")),
    *sorted(DOCS.glob("*.md")),
    *sorted((ROOT / "agents").rglob("*.md")),
]
LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
IMAGE = re.compile(r"!\[[^\]]+\]\(([^)\s]+)\)|<img [^>]*src=\"([^\"]+)\"")
BLOCK = re.compile(r"^```python\n(.*?)^```", re.DOTALL | re.MULTILINE)


def text_of(path):
    return path.read_text(encoding="utf-8")


def anchors(path):
    """The anchors of a page's headings."""
    heads = re.findall(r"^#+ (.*)$", text_of(path), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}


def with_blocks():
    return [page for page in PAGES if BLOCK.search(text_of(page))]


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


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
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


def test_the_pages_are_found_and_linked_from_their_index():
    assert len(PAGES) > 8
    linked = {link.partition("#")[0] for link in LINK.findall(text_of(DOCS / "README.md"))}
    assert {page.name for page in DOCS.glob("*.md")} - {"README.md"} <= linked


@pytest.mark.slow
@pytest.mark.parametrize("page", with_blocks(), ids=lambda page: page.name)
def test_every_example_runs(page, tmp_path):
    """The page's blocks in order, each with its own names, in one process in an empty folder."""
    # What the page on training reads: a checkpoint of a trained policy.
    path = tmp_path / "runs" / "paper" / "checkpoints" / "final.pt"
    save_checkpoint(path, make_network(load_scenario("paper"), "cascade"), "paper", 0)
    blocks = BLOCK.findall(text_of(page))
    for index, block in enumerate(blocks):
        (tmp_path / f"block_{index}.py").write_text(block, encoding="utf-8")
    program = (
        "import runpy\n"
        f"for index in range({len(blocks)}):\n"
        "    runpy.run_path(f'block_{index}.py', run_name='__main__')\n"
        "    print('done', index)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert f"done {len(blocks) - 1}" in done.stdout


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
