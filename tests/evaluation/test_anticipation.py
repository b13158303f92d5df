"""What the anticipating changer foresees, against Eq. 9 and against what happens on the road."""

import math

import numpy as np
import pytest

from marl_lanes import ScenarioError, load_scenario
from marl_lanes.evaluation.anticipation import Anticipation
from marl_lanes.evaluation.policies import (
    URGE,
    make_anticipating_cascade_policy,
    make_assertive_cascade_policy,
)
from marl_lanes.traffic.machine.state import Phase
from marl_lanes.traffic.simulator import Simulator

INTERACTIVE = load_scenario("interactive")
FEATURES = list(INTERACTIVE.observation.features)


def column(*values):
    return np.array(values, float)


def test_the_gap_is_that_of_the_gap_rule():
    """-b_safe = a_m (1 - (s*/s)^2), s* = s0 + max(0, v T + v dv/(2 sqrt(a_m b)))."""
    foresight = Anticipation(INTERACTIVE, 1.0)
    gap = foresight.needed_gap(column(25.0, 25.0, 25.0), column(0.0, 4.0, -8.0))
    # A follower that falls back fast keeps s0.
    wanted = (5.0 + 25.0, 5.0 + 25.0 + 25.0 * 4.0 / (2.0 * math.sqrt(3.0)), 5.0)
    for found, desired in zip(gap, wanted, strict=True):
        assert found == pytest.approx(desired / math.sqrt(3.0))
        assert 2.0 * (1.0 - (desired / found) ** 2) == pytest.approx(-4.0)


def test_the_gap_is_never_below_the_least_of_the_rule():
    close = load_scenario(INTERACTIVE, {"gap": {"minimum_gap": 4.0}})
    gap = Anticipation(close, 1.0).needed_gap(column(25.0, 0.0), column(-8.0, 0.0))
    assert gap == pytest.approx([4.0, 4.0])


def test_the_gap_is_that_of_the_most_common_driver():
    mixed = load_scenario(
        INTERACTIVE, {"drivers": {"mix": {"normal": 1.0, "defensive": 3.0, "aggressive": 2.0}}}
    )
    gap = Anticipation(mixed, 1.0).needed_gap(column(25.0), column(0.0))
    assert gap == pytest.approx((6.0 + 1.6 * 25.0) / math.sqrt(1.0 + 4.0 / 1.4))


def test_the_kinematic_rule_has_its_own_gap():
    kinematic = load_scenario(INTERACTIVE, {"gap": {"rule": "kinematic"}})
    gap = Anticipation(kinematic, 1.0).needed_gap(column(25.0, 25.0), column(4.0, -4.0))
    assert gap == pytest.approx([2.0 + 0.4 * 25.0 + 16.0 / 8.0, 2.0 + 0.4 * 25.0])


def test_the_time_to_the_marking_is_that_of_the_largest_lateral_acceleration():
    foresight = Anticipation(INTERACTIVE, 0.8)
    # The body is over the marking 2.775 m from the target's centre.
    time = foresight.time_to_marking(column(3.75, 3.75, 2.775, 1.0), column(0.0, 0.4, 0.4, 1.0))
    straight = math.sqrt(2.0 * 0.975 / 0.8)
    assert time[0] == pytest.approx(straight + 0.1)
    t = time[1] - 0.1
    assert 0.4 * t + 0.4 * t**2 == pytest.approx(0.975)
    assert time[2:] == pytest.approx(0.1)


def test_a_follower_far_behind_or_slow_is_no_reason_to_wait():
    foresight = Anticipation(INTERACTIVE, 1.0)
    speed, yaw = np.full(5, 22.0), np.zeros(5)
    deviation = column(3.75, 3.75, 3.75, 3.75, 3.5)
    gap = column(200.0, 12.0, 24.0, 24.0, 12.0)
    relative_speed = column(0.0, 0.0, 5.0, -5.0, 5.0)
    found = foresight.foresees_abort(speed, deviation, yaw, np.ones(5), gap, relative_speed)
    # The last one has begun its change.
    assert found.tolist() == [False, True, True, False, False]


def test_a_faster_follower_needs_more_room():
    speed, deviation, yaw = np.full(60, 22.0), np.full(60, 3.75), np.zeros(60)
    gaps = np.arange(60.0)
    waits = [
        Anticipation(INTERACTIVE, 1.0, follower)
        .foresees_abort(speed, deviation, yaw, np.full(60, own), gaps, np.full(60, dv))
        .sum()
        for own, follower, dv in (
            (1.0, 1.5, 0.0),
            (1.0, 3.0, 0.0),
            (1.0, 3.0, 4.0),
            (2.0, 3.0, 4.0),
        )
    ]
    assert waits[0] < waits[1] < waits[2]
    assert waits[3] < waits[2]


def test_it_waits_where_it_would_be_aborted_and_is_the_assertive_cascade_elsewhere():
    rows = np.zeros((5, len(FEATURES)), np.float32)
    for name, value in (
        ("speed", 22.0),
        ("lateral_deviation", 3.75),
        ("target_leader_gap", 200.0),
        ("target_follower_gap", 17.0),
        ("car_following_acceleration", 0.5),
        ("phase", Phase.ENGAGED),
    ):
        rows[:, FEATURES.index(name)] = value
    rows[1, FEATURES.index("target_follower_gap")] = 60.0
    rows[2, FEATURES.index("phase")] = Phase.ABORTING
    rows[3, FEATURES.index("yaw")] = 0.02
    # With more room ahead it pulls away, with less it cannot.
    rows[4, FEATURES.index("target_follower_gap")] = 18.0
    faster = rows[4:].copy()
    faster[0, FEATURES.index("car_following_acceleration")] = 1.0
    assert make_anticipating_cascade_policy(INTERACTIVE)(rows[4:])[0, 0] == 0.0
    assert make_anticipating_cascade_policy(INTERACTIVE)(faster)[0, 0] > 0.0
    actions = make_anticipating_cascade_policy(INTERACTIVE)(rows)
    hurried = make_assertive_cascade_policy(INTERACTIVE)(rows)
    assert actions[1:3] == pytest.approx(hurried[1:3])
    # It pulls ahead while it waits, too; and it straightens what it has turned.
    assert actions[:, 1] == pytest.approx(hurried[:, 1])
    assert actions[0, 0] == 0.0 < hurried[0, 0]
    assert actions[3, 0] < 0.0


def test_it_names_what_it_does_not_see():
    paper = load_scenario("paper")
    with pytest.raises(ScenarioError, match=r"must contain .*target_follower_gap.*anticipating-ca"):
        make_anticipating_cascade_policy(paper)
    steering = load_scenario("lateral_only", {"observation": {"features": FEATURES}})
    assert make_anticipating_cascade_policy(steering)(np.zeros((2, 15), np.float32)).shape == (2, 1)


@pytest.mark.slow
def test_what_it_foresees_comes_true():
    """Attempts of the assertive cascade: those it would not have begun are aborted."""
    scenario = load_scenario(INTERACTIVE, {"num_agents": None, "horizon": None})
    simulator = Simulator(scenario, 32, seed=5)
    simulator.reset()
    drive = make_assertive_cascade_policy(scenario)
    foresight = Anticipation(scenario, 1.0)
    open_attempts, ended = {}, []
    for _ in range(1200):
        seen, phase = simulator.state.observations, simulator.state.agents["phase"]
        acting = simulator.is_acting
        for place in list(open_attempts):
            if phase[place] != Phase.ENGAGED:
                ended.append((open_attempts.pop(place), phase[place] == Phase.ABORTING))
        for place in zip(*np.nonzero(acting & (phase == Phase.ENGAGED)), strict=True):
            if place not in open_attempts:
                columns = (
                    seen[place][FEATURES.index(name)].astype(float)[None]
                    for name in (
                        "speed",
                        "lateral_deviation",
                        "yaw",
                        "car_following_acceleration",
                        "target_follower_gap",
                        "target_follower_relative_speed",
                    )
                )
                speed, deviation, yaw, following, gap, faster = columns
                pull = np.clip(following + URGE, -3.0, 2.0)
                warned = foresight.foresees_abort(speed, deviation, yaw, pull, gap, faster)
                open_attempts[place] = bool(warned[0])
        actions = np.zeros_like(simulator.actions)
        if acting.any():
            actions[acting] = drive(seen[acting])
        simulator.step(actions)
    warned, aborted = np.array(ended, bool).T
    assert len(ended) > 300
    assert aborted[warned].mean() > 0.85
    assert aborted[~warned].mean() < 0.1
