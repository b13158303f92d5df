"""What a test may do by its markers: without one, nothing that takes long."""

import multiprocessing
import subprocess
import sys

import pytest

from marl_lanes.training.learner import Learner

PROGRAM = [sys.executable, "-c", "", "agents/naf/train.py"]


@pytest.mark.parametrize(
    "start",
    [
        lambda: Learner.train(None, None),
        lambda: subprocess.run(PROGRAM, check=True),
        lambda: multiprocessing.get_context("spawn").Process(target=int).start(),
    ],
    ids=["training", "program", "worker"],
)
def test_an_unmarked_test_may_not(start):
    with pytest.raises(pytest.fail.Exception, match="mark the test `training`"):
        start()


def test_an_unmarked_test_may_start_what_is_no_program_of_ours():
    subprocess.run([sys.executable, "-c", ""], check=True)


@pytest.fixture(scope="module")
def trained():
    with pytest.raises(pytest.fail.Exception) as caught:
        Learner.train(None, None)
    return str(caught.value)


def test_nor_may_its_fixtures(trained):
    assert trained == "Learner.train: mark the test `training`"


@pytest.mark.training
def test_a_marked_test_may():
    subprocess.run(PROGRAM, check=True)
    with pytest.raises(AttributeError):
        Learner.train(None, None)
