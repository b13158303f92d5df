"""The run folder's tables, and a training state that goes on as if nothing had happened."""

import csv
import json
import os
import signal
import subprocess
import sys

import pytest
import torch
from systems import needs

from marl_lanes.evaluation.metrics import summarise
from marl_lanes.naf.checkpoint import CheckpointError
from marl_lanes.training.config import EVALUATED, ConfigError
from marl_lanes.training.run_folder import (
    FINAL_MODEL,
    RunFolder,
    Table,
    check_extent,
    count_transitions,
)

torch.set_num_threads(1)

COLUMNS = ("transitions", "name", "value")
LEARNED = ("stage", "loss", "sigma")


def read(path):
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.reader(file))


def fill(path):
    """A table of rows a, b and c; where it ended after each."""
    table = Table(path, COLUMNS)
    extents = []
    for row in ((10, "a", 0.5), (20, "b", ""), (30, "c", 2.5)):
        table.append(row)
        extents.append(table.take_extent())
    table.append((30, FINAL_MODEL, 1.5))
    table.close()
    return extents


def test_a_table_begins_anew(tmp_path):
    path = tmp_path / "table.csv"
    fill(path)
    assert read(path)[0] == list(COLUMNS)
    assert [row[1] for row in read(path)[1:]] == ["a", "b", "c", FINAL_MODEL]
    assert read(path)[2] == ["20", "b", ""]
    Table(path, COLUMNS).close()
    assert read(path) == [list(COLUMNS)]


def test_a_row_is_in_the_file_at_once(tmp_path):
    table = Table(tmp_path / "table.csv", COLUMNS)
    table.append((1, "a", 2))
    assert read(tmp_path / "table.csv")[1:] == [["1", "a", "2"]]
    table.close()


@pytest.mark.parametrize("place", [0, 1, 2])
def test_a_resumed_table_goes_on_where_the_state_was_written(tmp_path, place):
    path = tmp_path / "table.csv"
    extent = fill(path)[place]
    check_extent(path, extent)
    table = Table(path, COLUMNS, extent=extent)
    table.append((501, "new", 0))
    table.close()
    assert [row[1] for row in read(path)] == ["name", *"abc"[: place + 1], "new"]
    assert [entry.name for entry in tmp_path.iterdir()] == ["table.csv"]


@pytest.mark.parametrize(
    "change",
    [
        lambda path: path.write_bytes(path.read_bytes().replace(b"0.5", b"0.7")),
        lambda path: path.write_bytes(path.read_bytes()[:-30]),
        lambda path: path.write_text("another", encoding="utf-8"),
        lambda path: path.unlink(),
    ],
)
def test_a_table_that_has_changed_is_refused(tmp_path, change):
    path = tmp_path / "table.csv"
    extent = fill(path)[1]
    change(path)
    with pytest.raises(CheckpointError, match=r"table .*table\.csv: must begin with the rows"):
        check_extent(path, extent)


@pytest.mark.parametrize("extent", [None, {}, 3, {"size": "x", "sha256": ""}, {"size": -1}])
def test_an_extent_that_is_none_is_refused(tmp_path, extent):
    fill(tmp_path / "table.csv")
    with pytest.raises(CheckpointError, match="must begin with the rows"):
        check_extent(tmp_path / "table.csv", extent)


def test_success_leads_what_is_told_of_a_saved_model():
    assert EVALUATED[:2] == ("success_rate", "completion_rate")
    assert set(EVALUATED) < set(summarise([]))


def test_a_new_run_makes_its_folder(tmp_path):
    path = tmp_path / "deep" / "run"
    run = RunFolder(path, LEARNED)
    run.log("train", {"loss": 1.0, "text": "left out", "none": None}, 5)
    run.close()
    names = {entry.name for entry in path.iterdir()}
    assert names == {
        ".lock",
        "checkpoints",
        "metrics.csv",
        "maneuvers.csv",
        "evaluations.csv",
        "tensorboard",
    }
    assert any((path / "tensorboard").glob("events.*"))
    assert read(path / "maneuvers.csv") == [["transitions", "return", "outcome"]]
    assert run.config == path / "config.yaml"
    assert run.state == path / "resume.pt"
    assert run.figures == path / "figures"
    assert run.film == path / "film.mp4"


@pytest.mark.parametrize(
    ("values", "chosen"),
    [
        ([-3.0, -1.0, -2.0], "b.pt"),
        ([-1.0, -2.0, -1.0], "a.pt"),
        (["", -10.0, 0.0], "c.pt"),
        (["", "", ""], "a.pt"),
    ],
)
def test_the_best_saved_model_becomes_the_final_one(tmp_path, values, chosen):
    """Of equals the earliest; one without a value is the worst."""
    run = RunFolder(tmp_path / "run", LEARNED, evaluated=("other", "quality"))
    for transitions, (name, value) in enumerate(zip("abc", values, strict=True)):
        (run.checkpoints / f"{name}.pt").write_text(name, encoding="utf-8")
        run.evaluations.append((transitions, f"{name}.pt", 7.0, value))
        run.trajectory(f"{name}.pt").parent.mkdir(exist_ok=True)
        run.trajectory(f"{name}.pt").write_text(f"road of {name}", encoding="utf-8")
    run.choose_model("quality")
    run.close()
    assert (run.checkpoints / "final.pt").read_text(encoding="utf-8") == chosen[0]
    recorded = run.path / "trajectories" / "final.parquet"
    assert recorded.read_text(encoding="utf-8") == f"road of {chosen[0]}"
    choice = json.loads((run.path / "choice.json").read_text(encoding="utf-8"))
    found = [None if value == "" else value for value in values]
    assert choice == {
        "quality": dict(zip(("a.pt", "b.pt", "c.pt"), found, strict=True)),
        "chosen": chosen,
    }


def test_a_model_may_be_chosen_without_a_recorded_road(tmp_path):
    run = RunFolder(tmp_path / "run", LEARNED, evaluated=("quality",))
    (run.checkpoints / "a.pt").write_text("a", encoding="utf-8")
    run.evaluations.append((0, "a.pt", 1.0))
    run.choose_model("quality")
    run.close()
    assert (run.checkpoints / "final.pt").read_text(encoding="utf-8") == "a"
    assert not (run.path / "trajectories").exists()


def test_a_folder_with_a_run_is_refused(tmp_path):
    run = RunFolder(tmp_path, LEARNED)
    run.metrics.append((1, 2, 3, 4, 5, 6, 7))
    extents = run.take_extents()
    run.close()
    run.config.write_text("seed: 0\n", encoding="utf-8")
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    with pytest.raises(ConfigError, match=r"output = .*must be a new or empty folder.*resume="):
        RunFolder(tmp_path, LEARNED)
    after = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    assert after == before
    RunFolder(tmp_path, LEARNED, extents=extents, until=1).close()
    assert len(read(tmp_path / "metrics.csv")) == 2
    with pytest.raises(CheckpointError, match=r"metrics\.csv"):
        RunFolder(tmp_path, LEARNED, extents={}, until=1)


@needs("fork")
def test_a_folder_in_which_another_process_trains_is_refused(tmp_path):
    """Until that process ends in whatever way; what it has forked does not matter."""
    program = (
        "import os, sys; from pathlib import Path\n"
        "from marl_lanes.training.run_folder import RunFolder\n"
        "run = RunFolder(Path(sys.argv[1]), ())\n"
        "if os.fork(): print(os.getpid(), flush=True)\n"
        "sys.stdin.read()"
    )
    path = tmp_path / "run"
    with subprocess.Popen(
        [sys.executable, "-c", program, str(path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        number = int(process.stdout.readline())
        before = {entry: entry.stat().st_mtime_ns for entry in path.rglob("*")}
        for extents in (None, {}):
            with pytest.raises(ConfigError, match=r"output = .*run': another process trains in it"):
                RunFolder(path, (), extents=extents)
        assert {entry: entry.stat().st_mtime_ns for entry in path.rglob("*")} == before
        # Its child lives on.
        os.kill(number, signal.SIGKILL)
        process.wait()
        with pytest.raises(ConfigError, match="must be a new or empty folder"):
            RunFolder(path, ())
        process.stdin.close()


def test_a_run_that_could_not_begin_leaves_nothing(tmp_path):
    RunFolder(tmp_path / "run", LEARNED).discard()
    assert list(tmp_path.iterdir()) == []


TABLE = "transitions,checkpoint\n0,a\n500,b\n1000,c\n"


@pytest.mark.parametrize(
    ("config", "wanted"),
    [("seed: 0", (1000, 0)), ("demonstrations: {num_transitions: 70}", (1000, 70))],
)
def test_all_transitions_of_a_run_are_counted(tmp_path, config, wanted):
    (tmp_path / "evaluations.csv").write_text(TABLE, encoding="utf-8")
    (tmp_path / "config.yaml").write_text(config, encoding="utf-8")
    assert count_transitions(tmp_path) == wanted


@pytest.mark.parametrize(
    ("table", "config"),
    [
        ("", "seed: 0"),
        ("transitions\n", "seed: 0"),
        ("number\n1\n", "seed: 0"),
        ("transitions\nmany\n", "seed: 0"),
        (TABLE, "[]"),
        (TABLE, "[1"),
        (TABLE, "demonstrations: 1"),
        (TABLE, "demonstrations: {}"),
    ],
)
def test_transitions_of_damaged_files_are_refused(tmp_path, table, config):
    (tmp_path / "evaluations.csv").write_text(table, encoding="utf-8")
    (tmp_path / "config.yaml").write_text(config, encoding="utf-8")
    with pytest.raises(ConfigError, match=r"evaluations\.csv and config\.yaml: must be"):
        count_transitions(tmp_path)
