"""Arrays in a GPU's memory, with numpy's in their place."""

from types import SimpleNamespace

import numpy as np
import pytest

from marl_lanes import Simulator

pytest.importorskip("numba_cuda")


def test_words_are_the_memory_itself():
    from marl_lanes.traffic.gpu_memory import words

    table = np.zeros((3, 2), np.dtype([("a", "f8"), ("b", "i4")]))
    found = words(table)
    assert (found.shape, found.dtype) == ((3, 6), np.uint32)
    found[1] = 7
    assert table["b"].tolist() == [[0, 0], [7, 7], [0, 0]]


def test_each_access_fetches_what_is_there_then():
    from marl_lanes.traffic.gpu_memory import FetchedState

    simulator = Simulator("paper", 2, seed=3)
    simulator.reset()
    fetched = []

    def fetch(array):
        fetched.append(array)
        return array.copy()

    state = FetchedState(SimpleNamespace(tables=simulator.state, fetch=fetch))
    assert state.tobytes() == simulator.state.tobytes()
    assert len(fetched) == len(state.arrays) == len(simulator.state.arrays)
    before, number = state.roads, len(fetched)
    simulator.step()
    assert (state.roads["step"] == before["step"] + 1).all()
    assert len(fetched) == number + 1
    assert not hasattr(state, "nothing")
    assert not hasattr(state, "_private")
