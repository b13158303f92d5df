"""Policies without learning."""

import numpy as np
import pytest

from marl_lanes import ScenarioError, load_scenario
from marl_lanes.evaluation.policies import (
    make_assertive_cascade_policy,
    make_lane_keeping_policy,
    make_mpc_policy,
    make_quintic_policy,
    make_random_policy,
    make_tuned_cascade_policy,
)
from marl_lanes.evaluation.rollout import run_maneuvers
from marl_lanes.traffic.machine.state import Outcome, Phase

# Many roads with two commands each take fewer steps than a few with ten.
SHORT = {"num_agents": 2, "command": {"probability": 1.0}}
PAPER = load_scenario("paper", SHORT)
# For a waiting changer in its lane the target's centre is one lane width away.
FEATURES = ("speed", "acceleration", "lateral_deviation", "yaw", "yaw_rate", "curvature")


@pytest.mark.parametrize("name", ["curved", "paper"])
def test_lane_keeping_never_changes_lanes(name):
    scenario = load_scenario(name, SHORT)
    maneuvers = run_maneuvers(scenario, make_lane_keeping_policy(scenario), 20, seed=1)
    assert {one.outcome for one in maneuvers} <= {Outcome.MISSED, Outcome.COLLISION}
    assert sum(one.outcome == Outcome.MISSED for one in maneuvers) > 15
    steered = [one.trace for one in maneuvers if len(one.trace) > 50]
    assert len(steered) > 10
    for rows in steered:
        assert rows["is_in_origin"].all()
        assert not rows["is_over_marking"].any()


@pytest.mark.parametrize(
    ("deviation", "yaw", "yaw_rate", "curvature", "sign"),
    [
        (3.75, 0.0, 0.0, 0.0, 0.0),
        (0.0, 0.0, 0.0, 0.0, 0.0),
        (-7.5, 0.0, 0.0, 0.0, 0.0),
        (3.85, 0.0, 0.0, 0.0, 1.0),
        (3.65, 0.0, 0.0, 0.0, -1.0),
        (3.75, 0.01, 0.0, 0.0, -1.0),
        (3.75, 0.0, 0.01, 0.0, -1.0),
        (3.75, 0.0, 0.04, 0.002, 0.0),
    ],
)
def test_lane_keeping_steers_to_the_nearest_centre(deviation, yaw, yaw_rate, curvature, sign):
    act = make_lane_keeping_policy(PAPER)
    actions = act(np.asarray([[20.0, 0.0, deviation, yaw, yaw_rate, curvature]], np.float32))
    assert actions.shape == (1, 1)
    assert np.sign(np.round(actions[0, 0], 6)) == sign


def test_lane_keeping_by_hand_and_within_its_bound():
    act = make_lane_keeping_policy(PAPER)
    rows = np.asarray(
        [[20.0, 0.0, 3.85, 0.01, 0.02, 0.0], [20.0, 0.0, 3.75, 0.2, 0.0, 0.0]], np.float32
    )
    # 2^3 0.1/20 - 3 2^2 0.01 - 3 2 0.02
    assert act(rows)[:, 0] == pytest.approx([0.04 - 0.12 - 0.12, -0.5], abs=1e-5)
    assert act(rows[:0]).shape == (0, 1)


def test_lane_keeping_finds_its_features_in_any_order():
    shuffled = tuple(reversed(FEATURES))
    other = load_scenario("paper", {"observation": {"features": shuffled}})
    row = np.asarray([[20.0, 0.0, 3.85, 0.01, 0.02, 0.001]], np.float32)
    actions = make_lane_keeping_policy(other)(row[:, ::-1])
    assert actions == pytest.approx(make_lane_keeping_policy(PAPER)(row))


MAKERS = {
    "lane-keeping": make_lane_keeping_policy,
    "tuned-cascade": make_tuned_cascade_policy,
    "assertive-cascade": make_assertive_cascade_policy,
    "quintic": make_quintic_policy,
    "mpc": make_mpc_policy,
}


@pytest.mark.parametrize("missing", ["speed", "lateral_deviation", "yaw", "yaw_rate", "curvature"])
@pytest.mark.parametrize("name", MAKERS)
def test_a_steering_policy_names_the_feature_that_it_lacks(missing, name):
    features = [feature for feature in FEATURES if feature != missing]
    other = load_scenario("paper", {"observation": {"features": features}})
    with pytest.raises(ScenarioError, match=rf"'paper'.*must contain \['{missing}'\] .*{name}"):
        MAKERS[name](other)


def test_the_mpc_needs_the_acceleration_too():
    features = [feature for feature in FEATURES if feature != "acceleration"]
    other = load_scenario("paper", {"observation": {"features": features}})
    with pytest.raises(ScenarioError, match=r"must contain \['acceleration'\] for the policy mpc"):
        make_mpc_policy(other)
    assert make_quintic_policy(other)(np.zeros((1, 5), np.float32)).shape == (1, 1)


@pytest.mark.parametrize("make", [make_quintic_policy, make_mpc_policy])
def test_a_planned_lane_change_is_completed(make):
    scenario = load_scenario("curved", SHORT)
    maneuvers = run_maneuvers(scenario, make(scenario), 4, seed=1)
    assert [one.outcome for one in maneuvers] == [Outcome.COMPLETED] * 4


@pytest.mark.parametrize("make", [make_quintic_policy, make_mpc_policy])
def test_a_planner_turns_with_the_road(make):
    """In a curve it does what it does on a straight road at the same yaw rate relative to it."""
    straight = np.asarray([[20.0, 0.5, 0.5, 0.04, 0.01, 0.0]], np.float32)
    curved = straight + np.asarray([[0.0, 0.0, 0.0, 0.0, 0.04, 0.002]], np.float32)
    act = make(PAPER)
    assert act(curved) == pytest.approx(act(straight), abs=1e-4)
    assert abs(act(straight)[0, 0]) > 0.01


def test_the_tuned_cascade_by_hand():
    act = make_tuned_cascade_policy(PAPER)
    rows = [
        [20.0, 0.0, 3.75, 0.0, 0.0, 0.0],
        [20.0, 0.0, 1.0, 0.04, 0.03, 0.001],
        [20.0, 0.0, 0.05, 0.0, 0.001, 0.0],
    ]
    # w_ref = 0.58/20 tanh((dev/1.38^2 - 2 0.775 20 yaw/1.38) / 0.58), the threshold 0.031.
    wanted = np.array([3.75 / 1.38**2, 1.0 / 1.38**2 - 2 * 0.775 * 20.0 * 0.04 / 1.38])
    reference = 0.58 / 20.0 * np.tanh(wanted / 0.58)
    demand = [reference[0] / 0.1 - 0.031, (reference[1] - 0.03 + 0.02) / 0.1 + 0.031]
    wanted = [*(0.5 * np.tanh(np.array(demand) / 0.5)), 0.0]
    assert act(np.asarray(rows, np.float32))[:, 0] == pytest.approx(wanted, rel=1e-5)
    assert act(np.zeros((0, 6), np.float32)).shape == (0, 1)


def test_the_tuned_cascade_changes_lanes_and_settles():
    maneuvers = run_maneuvers(PAPER, make_tuned_cascade_policy(PAPER), 30, seed=1)
    ended = [one.outcome for one in maneuvers]
    assert ended.count(Outcome.COMPLETED) >= 28
    assert set(ended) <= {Outcome.COMPLETED, Outcome.MISSED}


def test_random_is_seeded_and_within_the_bound():
    other = load_scenario("paper", {"action": {"max_yaw_acceleration": 0.2}})
    rows = np.zeros((500, 6), np.float32)
    first, again = (make_random_policy(other, 3)(rows) for _ in range(2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, make_random_policy(other, 4)(rows))
    assert first.shape == (500, 1)
    assert 0.19 < first.max() <= 0.2
    assert -0.2 <= first.min() < -0.19
    act = make_random_policy(PAPER, 3)
    assert not np.array_equal(act(rows), act(rows))
    assert act(rows).max() > 0.45
    assert act(rows[:0]).shape == (0, 1)


BOTH = load_scenario(
    PAPER,
    {
        "action": {"longitudinal": {"max_acceleration": 1.5, "max_braking": 2.5}},
        "observation": {"features": (*FEATURES, "phase", "car_following_acceleration")},
    },
)


def test_a_steering_policy_with_two_actions_follows_the_car_ahead():
    rows = np.asarray([[20.0, 0.0, 3.85, 0.01, 0.02, 0.001]] * 4, np.float32)
    more = np.asarray([[1.0, 0.75], [3.0, -1.25], [1.0, 9.0], [3.0, -9.0]], np.float32)
    for make in MAKERS.values():
        actions = make(BOTH)(np.hstack([rows, more]))
        assert actions[:, :1] == pytest.approx(make(PAPER)(rows))
        assert actions[:, 1].tolist() == [0.75, -1.25, 1.5, -2.5]
    assert make_lane_keeping_policy(BOTH)(np.zeros((0, 8), np.float32)).shape == (0, 2)


def test_lane_keeping_with_two_actions_drives_like_lane_keeping():
    """The agent applies the car-following acceleration: the same maneuvers up to rounding."""
    both = load_scenario(BOTH, {"action": {"longitudinal": {"max_braking": 8.0}}})
    driven = [
        run_maneuvers(scenario, make_lane_keeping_policy(scenario), 10, seed=1)
        for scenario in (both, PAPER)
    ]
    for one, other in zip(*driven, strict=True):
        assert one.outcome == other.outcome
        assert one.born_step == other.born_step
        assert one.time_to_end == pytest.approx(other.time_to_end, abs=0.5)


def test_lane_keeping_with_two_actions_needs_the_feature():
    other = load_scenario("paper", {"action": {"longitudinal": {}}})
    with pytest.raises(ScenarioError, match=r"must contain \['car_following_acceleration'\]"):
        make_lane_keeping_policy(other)


def test_random_with_two_actions_is_within_both_bounds():
    actions = make_random_policy(BOTH, 3)(np.zeros((2000, 7), np.float32))
    assert actions.shape == (2000, 2)
    low, high = actions.min(axis=0), actions.max(axis=0)
    assert low == pytest.approx([-0.5, -2.5], abs=0.02)
    assert high == pytest.approx([0.5, 1.5], abs=0.02)
    assert (low >= [-0.5, -2.5]).all()
    assert (high <= [0.5, 1.5]).all()
    assert abs(np.corrcoef(actions.T)[0, 1]) < 0.1


def test_the_assertive_cascade_hurries_while_it_is_engaged():
    scenario = load_scenario("interactive")
    features = list(scenario.observation.features)
    rows = np.zeros((5, len(features)), np.float32)
    rows[:, features.index("speed")] = 20.0
    rows[:, features.index("lateral_deviation")] = 3.75
    rows[:, features.index("car_following_acceleration")] = [0.5, 0.5, 0.5, 1.8, -4.0]
    rows[:, features.index("phase")] = [Phase.WAITING, Phase.ENGAGED, Phase.ABORTING, 2, 2]
    actions = make_assertive_cascade_policy(scenario)(rows)
    # Within the action's bounds, -3 to 2 m/s^2.
    assert actions[:, 1] == pytest.approx([0.5, 1.5, 0.5, 2.0, -3.0])
    calm = make_tuned_cascade_policy(scenario)(rows)
    assert calm[:, 1] == pytest.approx([0.5, 0.5, 0.5, 1.8, -3.0])
    assert (actions[:, 0] > calm[:, 0]).all()
    # With one action it steers, and nothing tells it the phase.
    alone = make_assertive_cascade_policy(PAPER)(np.zeros((2, 6), np.float32))
    assert alone.shape == (2, 1)
    without = [name for name in features if name != "phase"]
    other = load_scenario(scenario, {"observation": {"features": without}})
    with pytest.raises(ScenarioError, match=r"must contain \['phase'\] for the policy assertive"):
        make_assertive_cascade_policy(other)
