"""The reference, run by itself beside a simulator: the two are compared after every step."""

from collections import Counter

import numpy as np
from comparing import (
    compare_agents,
    compare_followers,
    compare_road,
    compare_vehicles,
    met_behind,
    met_beside,
    met_by_agents,
    moving_over,
)
from reference.road import Road


def follow_from_reset(case, num_steps):
    """Both from the seed on: reset, warm-up and steps."""
    simulator = case.simulator()
    road = Road.after_reset(simulator.scenario, case.seed)
    compare_road(road, simulator, 0)
    compare_vehicles(road, simulator, 0)
    return follow(case, simulator, road, num_steps)


def follow(case, simulator, road, num_steps):
    """Both from their present state on, each by itself; counts what occurred.

    Args:
        case: of ``drawn_scenarios``: the actions.
        simulator: one road.
        road: the same one of the reference.
        num_steps: time steps.
    """
    met = Counter()
    generator = np.random.default_rng(case.seed)
    for step in range(num_steps):
        moving = moving_over(road)
        actions, behind = case.choose(simulator, generator)
        wanted = _wanted(case, simulator, behind)
        simulator.step(actions, behind if case.has_learner else None)
        road.step(actions[0].tolist(), wanted)
        try:
            compare_road(road, simulator, 0)
            compare_vehicles(road, simulator, 0)
            compare_agents(road, simulator, 0)
            compare_followers(road, simulator, 0)
        except AssertionError as error:
            error.add_note(f"the kernel and the reference differ after step {step + 1}")
            raise
        met.update(met_by_agents(road))
        met.update(met_behind(road))
        met.update(met_beside(road, moving))
    met.update(record["kind"].name for record in road.collisions)
    return met


def _wanted(case, simulator, behind):
    """The followers' actions by slot, with those of the policies."""
    wanted, state = behind[..., 0].copy(), simulator.state
    for code, name in enumerate(simulator.scenario.followers.external_names):
        rows = state.followers["policy"] == code
        if name in case.policies and rows.any():
            wanted[rows] = case.policies[name](state.follower_observations[rows])
    return wanted[0].tolist()
