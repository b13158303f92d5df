"""The training program with workers: the same run on processes and on Ray; a worker's death."""

import importlib.util
import os
import re
import signal
import time

import pytest
from naf_program import (
    PROGRAM,
    TINY,
    assert_same_weights,
    prepare,
    run_here,
    start,
    weights,
)
from programs import load_program

from marl_lanes.training.resume import read_state

TABLES = ("metrics.csv", "maneuvers.csv", "evaluations.csv")
OPTIONS = [*TINY, "num_workers=2", "output=run"]
pytestmark = pytest.mark.training


@pytest.fixture(scope="module")
def program():
    """The program as a module, in this process."""
    return load_program(PROGRAM)


@pytest.fixture(scope="module")
def reference(program, tmp_path_factory):
    """A run with two processes."""
    folder = prepare(tmp_path_factory.mktemp("multi"))
    _, err = run_here(program, *OPTIONS, "collector=multi", folder=folder)
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


def started(*options, folder, num_models):
    """The program once it has saved models, and the workers' process ids."""
    with (folder / "stderr").open("w", encoding="utf-8") as stderr:
        process = start(*options, folder=folder, stderr=stderr)
    evaluations = folder / "run" / "evaluations.csv"
    while process.poll() is None:
        has_workers = len(worker_ids(said(folder))) == 2
        if has_workers and len(evaluations.read_bytes().splitlines()) > num_models:
            break
        time.sleep(0.01)
    return process, worker_ids(said(folder))


def said(folder):
    return (folder / "stderr").read_text(encoding="utf-8")


def test_interruptions_and_deaths_change_nothing(program, reference, tmp_path):
    run, _ = reference
    prepare(tmp_path)
    process, _ = started(*OPTIONS, "collector=multi", folder=tmp_path, num_models=1)
    # As Ctrl-C in a terminal: the workers receive it as well.
    os.killpg(process.pid, signal.SIGINT)
    out, _ = process.communicate(timeout=400)
    assert process.returncode == 0, said(tmp_path)[-3000:]
    assert "interrupted; continue with resume=run" in out

    process, (_, pid) = started("resume=run", folder=tmp_path, num_models=2)
    os.kill(pid, signal.SIGKILL)
    process.communicate(timeout=400)
    err = said(tmp_path)
    assert process.returncode == 1, err[-3000:]
    assert f"error: died: worker 1 of 2 (process {pid} on " in err
    assert "by SIGKILL; continue from the last saved model: resume=run" in err
    assert not (tmp_path / "run" / "checkpoints" / "final.pt").exists()
    assert 0 < read_state(tmp_path / "run" / "resume.pt")["counters"]["transitions"] < 300

    run_here(program, "resume=run", folder=tmp_path)
    assert_same_run(run, tmp_path / "run")


@pytest.mark.ray
@pytest.mark.skipif(
    importlib.util.find_spec("ray") is None, reason="Ray is not installed (extra ray)"
)
def test_a_ray_cluster_of_two_nodes_makes_the_same_run(program, reference, two_nodes, tmp_path):
    run, _ = reference
    options = (*OPTIONS, "collector=ray", f"ray.address={two_nodes}")
    _, err = run_here(program, *options, folder=prepare(tmp_path))
    assert len(set(worker_ids(err))) == 2
    assert_same_run(run, tmp_path / "run")
