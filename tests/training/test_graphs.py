"""A function that becomes a CUDA graph: every call is real, and what it is given is copied."""

import pytest
import torch
from tensordict import TensorDict

from marl_lanes.training import graphs
from marl_lanes.training.graphs import NUM_WARMUPS, Graphed


@pytest.fixture
def captured(monkeypatch):
    """Captures as on a GPU, but a replay calls the function; the functions that were captured."""
    functions = []

    def capture(function):
        functions.append(function)
        return function

    monkeypatch.setattr(graphs, "capture", capture)
    return functions


def test_every_call_is_one_call_of_the_function(captured):
    total = torch.zeros(3)

    def add(given):
        total.add_(given["value"])
        # What it writes to its input is not the caller's.
        given["seen"] = given["value"]
        return TensorDict({"total": total.clone()})

    add = Graphed(add)
    expected = torch.zeros(3)
    for number in range(2 * NUM_WARMUPS):
        assert len(captured) == (number > NUM_WARMUPS)
        given = TensorDict({"value": torch.full((3,), 1.0 + number)}, [3])
        expected += given["value"]
        assert torch.equal(add(given)["total"], expected)
        assert number < NUM_WARMUPS or "seen" not in given


def test_it_reads_its_own_copy_of_what_it_is_given(captured):
    places = []
    double = Graphed(lambda given: places.append(given["value"].data_ptr()) or given * 2)
    given = [TensorDict({"value": torch.full((2,), float(number))}, [2]) for number in range(8)]
    for number, one in enumerate(given):
        assert double(one)["value"].tolist() == [2.0 * number] * 2
    assert len(captured) == 1
    assert len(set(places[NUM_WARMUPS:])) == 1
    assert places[-1] not in {one["value"].data_ptr() for one in given}


def test_without_a_gpu_nothing_is_captured():
    assert not graphs.is_capturing()
