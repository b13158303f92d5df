"""The kernel compared with the reference, which runs by itself, in drawn scenarios."""

from collections import Counter

import numpy as np
import pytest
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
from drawn_scenarios import drawn, share_of
from hypothesis import given, note
from reference.road import Road

from marl_lanes.traffic.machine.state import CollisionKind, Outcome, Phase

NUM_STEPS = 300
COMPARED = compare_road, compare_vehicles, compare_agents, compare_followers
EVERYTHING = {
    *(outcome.name for outcome in Outcome),
    *(phase.name for phase in Phase if phase != Phase.ABSENT),
    *(kind.name for kind in CollisionKind),
    *("paired", "scripted", "delay", "abort", "collision", "discomfort", "braking"),
    *("moving over", "moved over", "took back"),
}
"""What must occur in the whole of the drawn scenarios."""


def wanted_of(drivers, simulator, behind):
    """The followers' actions by slot, with those of the policies."""
    wanted, state = behind[..., 0].copy(), simulator.state
    for code, name in enumerate(simulator.scenario.followers.external_names):
        rows = state.followers["policy"] == code
        if name in drivers.policies and rows.any():
            wanted[rows] = drivers.policies[name](state.follower_observations[rows])
    return wanted[0].tolist()


def follow(case):
    """Both from the state after the reset on, each by itself; counts what occurred."""
    simulator = case.simulator()
    road, met = Road.of(simulator), Counter()
    generator = np.random.default_rng(case.seed)
    for step in range(NUM_STEPS):
        moving = moving_over(road)
        actions, behind = case.choose(simulator, generator)
        wanted = wanted_of(case, simulator, behind)
        simulator.step(actions, behind if case.has_learner else None)
        road.step(actions[0].tolist(), wanted)
        try:
            for compare in COMPARED:
                compare(road, simulator, 0)
        except AssertionError:
            note(f"they differ after step {step + 1}")
            raise
        met.update(met_by_agents(road))
        met.update(met_behind(road))
        met.update(met_beside(road, moving))
    met.update(record["kind"].name for record in road.collisions)
    return met


def hold(number, *, is_whole):
    met = Counter()

    @share_of(number, is_whole=is_whole)
    @given(drawn())
    def compare(case):
        met.update(follow(case))
        met["cases"] += 1

    compare()
    assert met["cases"] >= number
    return met


def test_the_reference_alone_does_what_the_kernel_does():
    hold(6, is_whole=False)


@pytest.mark.long
def test_the_reference_alone_does_what_the_kernel_does_in_hundreds_of_scenarios():
    met = hold(300, is_whole=True)
    assert set(met) >= EVERYTHING, EVERYTHING - set(met)
