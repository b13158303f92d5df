"""Which driver is paired with which changer, and for how long."""

import pytest
from external_followers import ABORT, DELAY, DISCOMFORT, OPEN_GAP, pair_of, pay

from marl_lanes.traffic.machine.state import Phase


def test_a_driver_with_a_command_of_its_own_is_not_external():
    simulator, slot = pair_of()
    assert simulator.state.followers[0, slot]["vehicle"] == 0
    assert simulator.is_follower_acting[0, slot]
    simulator, slot = pair_of(commanded=True)
    assert simulator.agents[0, slot]["target_follower"] == 0
    assert simulator.vehicles[0, 0]["changer"] == 1
    assert (simulator.state.followers["vehicle"] == -1).all()
    assert not simulator.is_follower_acting.any()
    assert pay(simulator, slot, 3.0) == [0.0] * 5
    assert simulator.vehicles[0, 0]["acceleration"] < 3.0


def test_an_abort_is_rewarded_once_and_ends_the_pairing():
    guard = {**OPEN_GAP, "minimum_gap": 2.0}
    simulator, slot = pair_of(gap=2.35, speeds=(20.0, 18.0), guard=guard)
    assert simulator.is_follower_acting[0, slot]
    terms = pay(simulator, slot, 3.0)
    assert simulator.agents[0, slot]["phase"] == Phase.ABORTING
    assert terms == pytest.approx([DELAY * 0.1, ABORT, 0.0, -DISCOMFORT * 9.0, 0.0])
    assert not simulator.is_follower_acting[0, slot]
    total = simulator.state.followers[0, slot]["episode_reward"]
    assert pay(simulator, slot, 3.0) == [0.0] * 5
    assert simulator.state.followers[0, slot]["episode_reward"] == total
