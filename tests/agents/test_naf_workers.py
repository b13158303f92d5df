"""The training program with workers: the same run on processes and on Ray; a worker's death."""

import importlib.util
import multiprocessing
import os
import re
import signal
import threading
import time

import pytest
from naf_program import (
    PROGRAM,
    TINY,
    UNRECORDED,
    assert_same_weights,
    prepare,
    start,
    weights,
)
from programs import load_program, run_main

from marl_lanes.training.resume import read_state

TABLES = ("metrics.csv", "maneuvers.csv", "evaluations.csv")
OPTIONS = [*TINY, UNRECORDED, "num_workers=2", "output=run"]
pytestmark = pytest.mark.training


@pytest.fixture(scope="module")
def program():
    """The program as a module, in this process."""
    return load_program(PROGRAM)


@pytest.fixture(scope="module")
def reference(program, tmp_path_factory):
    """A run with two processes."""
    folder = prepare(tmp_path_factory.mktemp("multi"))
    _, err = run_main(program, folder, *OPTIONS, "collector=multi")
    return folder / "run", err


def assert_same_run(one, other):
    assert_same_weights(weights(one), weights(other))
    for name in TABLES:
        assert (one / name).read_bytes() == (other / name).read_bytes(), name


def worker_ids(err):
    return [int(pid) for pid in re.findall(r"worker \d: process (\d+) on ", err)]


def test_a_run_names_its_workers(reference):
    _, err = reference
    assert len(set(worker_ids(err))) == 2


def num_models(run):
    """That are saved by now."""
    table = run / "evaluations.csv"
    return len(table.read_bytes().splitlines()) - 1 if table.exists() else 0


def kill_a_worker(run, after):
    """Once so many models are saved; its process id is appended to the list that is returned."""
    killed = []

    def watch():
        while num_models(run) < after or not multiprocessing.active_children():
            time.sleep(0.01)
        (worker, *_) = multiprocessing.active_children()
        os.kill(worker.pid, signal.SIGKILL)
        killed.append(worker.pid)

    threading.Thread(target=watch, daemon=True).start()
    return killed


def test_interruptions_and_deaths_change_nothing(program, reference, tmp_path):
    reference_run, _ = reference
    run = prepare(tmp_path) / "run"
    process = start(*OPTIONS, "collector=multi", folder=tmp_path)
    while process.poll() is None and num_models(run) < 1:
        time.sleep(0.01)
    # As Ctrl-C in a terminal: the workers receive it as well.
    os.killpg(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=400)
    assert process.returncode == 0, err[-3000:]
    assert "interrupted; continue with resume=run" in out
    assert num_models(run) == 1

    killed = kill_a_worker(run, after=2)
    with pytest.raises(SystemExit) as caught:
        run_main(program, tmp_path, "resume=run")
    (pid,) = killed
    assert re.fullmatch(
        rf"error: died: worker \d of 2 \(process {pid} on .*\) by SIGKILL; "
        "continue from the last training state: resume=run",
        caught.value.code,
    )
    assert not (run / "checkpoints" / "final.pt").exists()
    assert 0 < read_state(run / "resume.pt")["counters"]["transitions"] < 300

    run_main(program, tmp_path, "resume=run")
    assert_same_run(reference_run, run)


@pytest.mark.ray
@pytest.mark.skipif(
    importlib.util.find_spec("ray") is None, reason="Ray is not installed (extra ray)"
)
# An older Ray does not close its log files.
@pytest.mark.filterwarnings("ignore:Exception ignored in:pytest.PytestUnraisableExceptionWarning")
def test_a_ray_cluster_of_two_nodes_makes_the_same_run(program, reference, two_nodes, tmp_path):
    run, _ = reference
    options = (*OPTIONS, "collector=ray", f"ray.address={two_nodes}")
    _, err = run_main(program, prepare(tmp_path), *options)
    assert len(set(worker_ids(err))) == 2
    assert_same_run(run, tmp_path / "run")
