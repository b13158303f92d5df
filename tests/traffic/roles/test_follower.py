"""The follower's observation and reward."""

from types import SimpleNamespace

import numpy as np
import pytest
from external_followers import BRAKING, COLLISION, DELAY, DISCOMFORT, pair_of, pay

from marl_lanes.traffic.machine.state import Phase
from marl_lanes.traffic.roles.external import FOLLOWER_COLUMNS
from marl_lanes.traffic.roles.follower import FOLLOWER, Step


def test_before_the_body_is_in_the_lane_the_delay_is_rewarded():
    terms = pay(*pair_of(), 0.5)
    assert terms == pytest.approx([DELAY * 0.1, 0.0, 0.0, -DISCOMFORT * 0.25, 0.0])


def test_braking_beyond_hard_braking_costs_reward():
    terms = pay(*pair_of(), -2.5)
    assert terms == pytest.approx([DELAY * 0.1, 0.0, 0.0, -DISCOMFORT * 6.25, -BRAKING * 1.5])


def test_once_the_body_is_in_the_lane_there_is_no_delay():
    terms = pay(*pair_of(lateral=7.0), -0.5)
    assert terms == pytest.approx([0.0, 0.0, 0.0, -DISCOMFORT * 0.25, 0.0])


def test_interpreted_formulas_square_as_compiled_ones_do():
    """A power of 2 by the C library rounds some of these numbers differently from a product."""
    (discomfort,) = [term for term in FOLLOWER.terms if term.name == "discomfort"]
    accelerations = np.random.default_rng(0).uniform(-4.0, 4.0, 10_000)
    for acceleration in accelerations:
        step = Step(SimpleNamespace(acceleration=acceleration), None, None, False, None)
        assert discomfort.formula(0.01, step) == -0.01 * (acceleration * acceleration)


def test_a_collision_costs_its_penalty():
    simulator, slot = pair_of(gap=1.6, speeds=(25.0, 14.0), lateral=8.5)
    assert simulator.is_follower_acting[0, slot]
    terms = pay(simulator, slot, 3.0)
    assert simulator.roads["num_collisions"][0] == 1
    assert simulator.has_ended[0, slot]
    assert terms == pytest.approx([0.0, 0.0, -COLLISION, -DISCOMFORT * 9.0, 0.0])


def test_the_driver_observes_the_changer_and_the_one_ahead_of_it():
    simulator, slot = pair_of(gap=30.0, speeds=(22.0, 19.0))
    driver, changer = simulator.vehicles[0, :2]
    wanted = {
        "speed": driver["speed"],
        "acceleration": driver["acceleration"],
        "gap": changer["position"] - driver["position"] - 4.8,
        "relative_speed": changer["speed"] - driver["speed"],
        "changer_lateral_deviation": 9.375 - changer["lateral_position"],
        "changer_lateral_speed": changer["speed"] * np.sin(changer["yaw"]),
        # Without a vehicle ahead in its lane.
        "leader_gap": 200.0,
        "leader_relative_speed": 0.0,
        "phase": Phase.ENGAGED,
    }
    seen = simulator.state.follower_observations[0, slot]
    found = {name: float(seen[column]) for name, column in FOLLOWER_COLUMNS.items()}
    assert found == pytest.approx(wanted, rel=1e-6, abs=1e-7)
