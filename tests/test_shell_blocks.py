"""Every shell command of every page runs: in order, in a folder like the repository's."""

import gc
import multiprocessing.dummy
import re
import shutil
import signal
import webbrowser
from importlib import resources
from pathlib import Path
from types import SimpleNamespace

import pytest
import shell_runs
from doc_pages import COMMANDS, name_of
from matplotlib.figure import Figure
from shell_runs import CommandError, configure, look_up, make, parse
from systems import needs_posix

from marl_lanes import studies
from marl_lanes.cli import watch
from marl_lanes.evaluation import aftermath, recording
from marl_lanes.report import conclusion
from marl_lanes.scenario import loading
from marl_lanes.scenario.yaml_files import format_yaml, read_yaml

pytestmark = [pytest.mark.slow, pytest.mark.training, needs_posix]

NOT_RUN = {
    r"^make (check|test|docs|coverage|mutation|trials)\b": ("tests, or installs", make),
    r"^\.ci/run": ("tests, and installs", look_up),
    r"-m pytest": ("tests", look_up),
    r"\bpip |^uv |-m venv": ("installs", look_up),
    r"^ray start": ("a cluster of machines", look_up),
    r"collector=(multi|ray)": ("processes, each of which loads torch", configure),
    r"device=cuda": ("a GPU", configure),
    r"benchmarks/(gpu|gpu_training)\.py": ("a GPU", parse),
    r"benchmarks/(?!gpu|soak)\w+\.py": ("measures for a minute, or more", parse),
}
"""By what is in a command: why it is not run here, and what is tried instead."""
STANDS_FOR = {
    "marl-lanes train FIELD=VALUE": "marl-lanes train output=runs/form_{number}",
    "FIELD=VALUE": "loss.gamma=0.99",
    "zoo NAME": "zoo paper",
    "--task NAME": "--task paper",
    "--only NAME": "--only paper",
    "scenario=NAME": "scenario=paper",
    "network.mu=NAME": "network.mu=cascade",
    "changer=CHECKPOINT": "changer=zoo:interactive",
    "output=DIR": "output=runs/form_{number}",
    "generations=N": "generations=1",
    "seed=N": "seed=1",
    "--vehicle-steps N": "--vehicle-steps 1000",
    "--threads N": "--threads 1",
    " N": " 2",
    "POLICY": "tuned-cascade",
    "TEXT": "mine",
    "--json FILE": "--json figures.json",
    "FILE": "docs/benchmark/mpc.json",
    "PAGE": "docs/benchmark.md",
    "--zoo FOLDER": "--zoo zoo",
}
"""What the forms of a command leave to the reader, and a value of it, in this order."""
IN_FEWER_STEPS = {
    "changer_3.pt": "changer_1.pt",
    "step_000408551.pt": "final.pt",
    "--road 17": "--road 0",
    "--road 2": "--road 0",
}
"""What only the whole budget makes, and what stands for it."""
SHORT = {"num_agents": 1, "horizon": 55.0, "command": {"probability": 1.0}}
EPISODES = {
    "paper": {"num_agents": 1, "horizon": 55.0},  # `doctor` knows its traffic
    "dense": {"horizon": 55.0},  # the pages show later commands of these two
    "yielding": {"horizon": 55.0},
    "interactive": {**SHORT, "horizon": 20.0},
    "hidden": {**SHORT, "horizon": 20.0},
}
"""Of the shipped scenarios here, by name; of the others SHORT."""


def forms_of(line, number):
    """The command lines that a form stands for: with all its options, one for each alternative."""
    line = spell_out(line)
    for shown, typed in (*STANDS_FOR.items(), *IN_FEWER_STEPS.items()):
        line = re.sub(rf"{re.escape(shown)}(?![\w=])", typed.format(number=number), line)
    words = [alternatives(word) for word in line.split(" ") if word]
    return [
        " ".join(word[min(index, len(word) - 1)] for word in words)
        for index in range(max(map(len, words)))
    ]


def spell_out(line):
    """The line with all that it has in brackets, and with slashes."""
    line = re.sub(r"(?<!\S)\[([^\]]*)\](?!\S)", r"\1", line.replace("\\", "/"))
    return re.sub(r"\s+\.\.\.(?!\S)", "", line)


def alternatives(word):
    """What ``A|B`` and ``field=A|B`` leave the choice of."""
    field, is_set, value = word.rpartition("=")
    return [field + is_set + one for one in re.split(r"(?<=\w)\|(?=\w)", value)]


@pytest.fixture
def patch(tmp_path_factory, monkeypatch):
    """Short episodes, studies in this process, and what serves ends once it does."""
    folder = tmp_path_factory.mktemp("scenarios")
    context = multiprocessing.get_context
    for file in resources.files("marl_lanes.scenarios").iterdir():
        if file.name.endswith(".yaml"):
            fields = {**read_yaml(file), **EPISODES.get(file.stem, SHORT)}
            (folder / file.name).write_text(format_yaml(fields), encoding="utf-8")
    shipped = SimpleNamespace(files=lambda _: folder, as_file=resources.as_file)
    monkeypatch.setattr(loading, "resources", shipped)
    for module in (aftermath, recording):
        monkeypatch.setattr(module, "WATCHED_TIME", 2.0)
    monkeypatch.setattr(studies, "carry_out", shell_runs.carry_out)
    monkeypatch.setattr(webbrowser, "open", lambda _: True)
    monkeypatch.setattr(gc, "freeze", lambda: None)
    monkeypatch.setattr(
        multiprocessing,
        "get_context",
        lambda kind=None: multiprocessing.dummy if kind == "spawn" else context(kind),
    )
    for name in ("film_first_and_last", "replay_failures"):
        monkeypatch.setattr(conclusion, name, lambda *_, **__: None)
    shell_runs.trained()
    monkeypatch.setattr(Figure, "savefig", lambda _, file, **__: Path(file).touch())
    for name in ("draw_training", "draw_first_and_last", "write_report"):
        monkeypatch.setattr(conclusion, name, lambda *_: None)
    monkeypatch.setattr(watch, "say", lambda _: signal.raise_signal(signal.SIGINT))


@pytest.mark.usefixtures("patch")
@pytest.mark.parametrize("page", COMMANDS, ids=name_of)
def test_every_command_of_the_page_runs(page, tmp_path):
    shell_runs.lay_out(tmp_path)
    faults = []
    for number, line in enumerate(COMMANDS[page]):
        first, *others = forms_of(line, number)
        way = next((way for key, (_, way) in NOT_RUN.items() if re.search(key, line)), None)
        try:
            (way or shell_runs.run)(first, tmp_path)
            for other in others:
                (parse if "marl-lanes" in other else configure)(other, tmp_path)
        except CommandError as fault:
            faults.append(str(fault))
    shutil.rmtree(tmp_path)
    assert not faults, "\n".join(faults)


def test_the_tables_have_what_the_pages_show():
    lines = [spell_out(line) for lines in COMMANDS.values() for line in lines]
    for key in (*NOT_RUN, *shell_runs.QUICK):
        assert any(re.search(key, line) for line in lines), key
    for key in (*STANDS_FOR, *IN_FEWER_STEPS):
        assert any(key in line for line in lines), key
    assert len(lines) > 100
