"""Where roads are made: what they take is known, and refused where it is not there."""

from types import SimpleNamespace

import numpy as np
import psutil
import pytest

from marl_lanes import Simulator, load_scenario
from marl_lanes.traffic import placement
from marl_lanes.traffic.parameters import make_parameters
from marl_lanes.traffic.placement import bytes_of_road, place_on_gpu, place_on_host

PAPER = load_scenario("paper")


@pytest.mark.parametrize("name", ["five_lanes", "interactive", "paper"])
def test_a_road_takes_what_its_arrays_take(name):
    scenario = load_scenario(name)
    roads = place_on_host(scenario, make_parameters(scenario), 3, 1)
    arrays = (*roads.state.arrays, roads.actions, roads.follower_actions)
    assert {len(array) for array in arrays} == {3}
    assert sum(array.nbytes for array in arrays) == 3 * bytes_of_road(scenario)
    assert Simulator(scenario).bytes_per_environment == bytes_of_road(scenario)


def test_roads_are_made_empty():
    roads = place_on_host(PAPER, make_parameters(PAPER), 2, 1)
    assert (roads.state.vehicles["id"] == -1).all()
    assert not roads.state.roads["num_live"].any()
    assert not np.any(roads.actions)


def make_nothing(**_):
    raise AssertionError("roads are made")


def test_more_than_the_computer_has_left_is_refused_first(monkeypatch):
    available = 10 * bytes_of_road(PAPER)
    monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(available=available))
    place_on_host(PAPER, make_parameters(PAPER), 10, 1)
    monkeypatch.setattr(placement, "bytes_of_road", lambda _: available // 10)
    monkeypatch.setattr(placement, "allocate", make_nothing)
    with pytest.raises(ValueError, match=r"^num_envs = 11: needs .* of memory, .* at most 10 here"):
        place_on_host(PAPER, make_parameters(PAPER), 11, 1)


def test_more_than_the_gpu_has_left_is_refused_first(monkeypatch):
    left = 10.0 * bytes_of_road(PAPER), "memory of cuda:2"
    monkeypatch.setattr(placement, "find_memory", {2: left}.get)
    with pytest.raises(ValueError, match=r"^num_envs = 11: .* of cuda:2, .* at most 10 here"):
        place_on_gpu(PAPER, make_parameters(PAPER), 11, learner=-2, gpu=2)
