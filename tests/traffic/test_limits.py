"""Scenarios at the limits of their fields, with the largest actions: finite, and within bounds."""

import numpy as np
import pytest
from scenario.drawing import draw_scenario
from staging import assert_conserved, present

from marl_lanes.traffic.simulator import Simulator

STATE = ("position", "lateral_position", "speed", "acceleration", "yaw", "yaw_rate", "advance")
PAID = ("reward", "episode_reward", "terms")


def drive_at_limits(seed, num_steps, corner=None):
    """Drive two roads of a drawn scenario; returns how often an agent and a follower acted."""
    generator = np.random.default_rng(seed)
    scenario = draw_scenario(generator, corner, warmup=[0.0, 30.0], num_agents=None)
    simulator = Simulator(scenario, 2, seed=seed, learned_followers=True)
    simulator.reset()
    acted = np.zeros(2, int)
    for step in range(num_steps):
        actions = generator.choice([-1e308, -1.0, 0.0, 1.0, 1e308], simulator.actions.shape)
        behind = generator.choice([-1e308, 0.0, 1e308], simulator.follower_actions.shape)
        if step % 40 < 20:
            actions *= 0.0
        elif step % 40 < 30:
            # The same for a while, to turn and to brake as far as possible.
            actions[:], behind[:] = actions.flat[0], behind.flat[0]
        acted += simulator.is_acting.sum(), simulator.is_follower_acting.sum()
        simulator.step(actions, behind)
        for role in simulator.roles:
            low, high = role.observation_bounds(scenario)
            seen = getattr(simulator.state, role.observations)
            assert ((low <= seen) & (seen <= high)).all(), (seed, step, role.name)
            table = getattr(simulator.state, role.table)
            assert all(np.isfinite(table[name]).all() for name in PAID), (seed, step, role.name)
        cars = simulator.vehicles[present(simulator)]
        assert all(np.isfinite(cars[name]).all() for name in STATE), (seed, step)
        assert (cars["speed"] >= 0.0).all()
        if simulator.roads["is_done"].any():
            simulator.reset(simulator.roads["is_done"] == 1)
    assert_conserved(simulator)
    return acted


@pytest.mark.parametrize("corner", [0, 1])
def test_with_all_fields_at_one_end_of_their_limits_everything_is_finite(corner):
    drive_at_limits(corner, 60, corner)


def test_with_fields_anywhere_in_their_limits_everything_is_finite():
    acted = sum(drive_at_limits(seed, 120) for seed in range(12, 40))
    assert (acted > 15).all(), acted


@pytest.mark.long
def test_with_fields_anywhere_in_their_limits_everything_is_finite_for_thousands_of_steps():
    acted = sum(drive_at_limits(seed, 2000) for seed in range(1000, 1300))
    assert (acted > 3000).all()
