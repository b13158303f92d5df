"""The optimum against a primal program, the simulator, and searches for a better one."""

import math

import numpy as np
import pytest
from optima import (
    LANE_WIDTH,
    PASSING,
    PROFILES,
    ROADS,
    SETTLED,
    curved_start,
    lane_change,
    primal_cost,
    replay_of,
    scenario_of,
)

from marl_lanes import load_scenario
from marl_lanes.evaluation import optimum as module
from marl_lanes.evaluation.optimum import optimal_lane_change
from marl_lanes.evaluation.replay import DEVIATION, LATERAL_SPEED, YAW_RATE
from marl_lanes.scenario import Scenario

ENDS = pytest.mark.parametrize("completion", [PASSING, SETTLED], ids=["passing", "settled"])

SPEEDS = pytest.mark.parametrize("profile", PROFILES.values(), ids=PROFILES.keys())

CURVES = pytest.mark.parametrize("arcs", ROADS.values(), ids=ROADS.keys())


def cost_until_completed(scenario: Scenario, actions: np.ndarray, known: np.ndarray) -> float:
    """Sum of Eq. 10, Eq. 11 and Eq. 12 until the change is first complete; else infinity."""
    rule = scenario.completion
    is_there = np.abs(known[DEVIATION]) <= rule.max_deviation
    is_there &= np.abs(known[LATERAL_SPEED]) <= (rule.max_lateral_speed or math.inf)
    is_there &= np.abs(known[YAW_RATE]) <= (rule.max_yaw_rate or math.inf)
    if not is_there.any():
        return math.inf
    n = int(np.argmax(is_there)) + 1
    terms = 2.0 * np.abs(actions) + 0.5 * np.abs(known[YAW_RATE])
    return float((terms + 0.05 * np.abs(known[DEVIATION]) / 1.875)[:n].sum())


@pytest.mark.parametrize(
    ("speed", "completion", "expected", "num_steps"),
    [
        (16.0, PASSING, -3.64, 32),
        (20.0, PASSING, -3.33, 30),
        (24.0, PASSING, -3.09, 28),
        (28.0, PASSING, -2.91, 26),
        (16.0, SETTLED, -4.90, 66),
        (20.0, SETTLED, -4.52, 62),
        (24.0, SETTLED, -4.23, 58),
        (28.0, SETTLED, -4.00, 54),
    ],
)
def test_known_returns(speed, completion, expected, num_steps):
    optimum = lane_change(np.full(40, speed), completion)

    assert optimum.total_return == pytest.approx(expected, rel=0.01)
    assert abs(optimum.num_steps - num_steps) <= 1  # The cost is flat there.
    assert optimum.yaw_acceleration.shape == (optimum.num_steps,)
    assert optimum.yaw_acceleration.dtype == np.float64


@pytest.mark.parametrize(
    ("speed", "expected", "num_steps"),
    [
        (np.full(300, 0.6), -15.276, 172),
        (np.full(300, 1.0), -13.003, 163),
        (np.full(300, 2.0), -10.304, 131),
        (np.full(300, 3.0), -8.947, 115),
        (np.full(300, 4.0), -8.082, 104),
        # Out of a queue: from the path of lane keeping alone -116.07, -120.02 and -8.53 were found.
        (0.58 + 0.18 * np.arange(109), -7.1665, 89),
        (0.58 + 0.2 * np.arange(109), -6.9780, 86),
        (np.maximum(0.58, 0.15 * np.arange(109) - 0.62), -8.0058, 98),
        # Here two solutions of one duration alternate.
        (0.58 + 0.15 * np.arange(109), -7.5018, 92),
    ],
)
def test_from_near_standstill_it_is_found_as_well(speed, expected, num_steps):
    optimum = optimal_lane_change(load_scenario("five_lanes"), speed, deviation=3.75)
    assert optimum.total_return == pytest.approx(expected, rel=1e-4)
    assert optimum.num_steps == num_steps


@ENDS
@SPEEDS
def test_search_finds_what_a_scan_of_every_duration_finds(profile, completion):
    """The oracle replaces sin(psi) by psi, an error of 3e-4 at the 0.04 rad of a lane change."""
    costs = {n: primal_cost(profile, n, completion) for n in range(16, 91)}
    cheapest = min(costs, key=costs.__getitem__)

    optimum = lane_change(profile, completion)

    assert 16 < cheapest < 90
    assert costs[optimum.num_steps] == pytest.approx(costs[cheapest], rel=1e-4)
    assert optimum.total_return == pytest.approx(-costs[cheapest], rel=5e-4)


def test_the_cheaper_of_two_dips_over_the_duration_is_found():
    """A descent from 40 steps or fewer ends in the first one."""
    slow, fast = 9.1, 18.8
    speed = [np.full(23, fast), np.linspace(fast, slow, 8), np.full(14, slow)]
    speed = np.concatenate([*speed, np.linspace(slow, fast, 5), np.full(60, fast)])
    costs = np.array([primal_cost(speed, n, SETTLED) for n in range(1, 100)])
    is_dip = (costs[1:-1] < costs[:-2]) & (costs[1:-1] <= costs[2:])
    dips = np.flatnonzero(is_dip) + 2
    assert costs[dips - 1].tolist() == pytest.approx([5.08, 4.96], abs=0.01)
    for num_recorded in (60, 80, len(speed)):
        optimum = lane_change(speed[:num_recorded])
        assert abs(optimum.num_steps - dips[1]) <= 1
        assert optimum.total_return == pytest.approx(-costs.min(), rel=5e-4)


@pytest.mark.parametrize("num_recorded", [1, 5, 20, 45, 250])
def test_recorded_duration_does_not_matter(num_recorded):
    optimum = lane_change(np.full(num_recorded, 22.0))
    assert optimum.num_steps in {59, 60, 61}


def test_binding_action_bound():
    speed = np.full(40, 20.0)
    costs = {n: primal_cost(speed, n, PASSING, max_yaw_acceleration=0.15) for n in range(20, 60)}
    optimum = lane_change(speed, PASSING, action={"max_yaw_acceleration": 0.15})

    assert np.abs(optimum.yaw_acceleration).max() == pytest.approx(0.15, abs=1e-9)
    assert optimum.total_return == pytest.approx(-min(costs.values()), rel=1e-3)
    assert optimum.total_return < lane_change(speed, PASSING).total_return - 1e-3


# Searches for a better one


def cascade_cost(scenario, speed, start, gains):
    """A good policy: a lateral acceleration, a yaw-rate loop and a dead zone."""
    period, damping, top, lag, dead = gains
    replay, actions = replay_of(scenario, speed, start), np.zeros(len(speed))
    e, lateral, turning = start["deviation"], 0.0, 0.0
    for k, v in enumerate(speed):
        wanted = e / period**2 - 2.0 * damping * lateral / period
        reference = top / v * math.tanh(wanted / top)
        action = 0.5 * math.tanh((reference - turning) / (0.5 * lag))
        actions[k] = math.copysign(max(0.0, abs(action) - dead), action)
        known = replay.follow(actions[: k + 1])
        turning, lateral, e = known[[YAW_RATE, LATERAL_SPEED, DEVIATION], -1]
    return cost_until_completed(scenario, actions, known)


@pytest.mark.slow
@CURVES
@pytest.mark.parametrize("direction", [1, -1])
def test_no_policy_of_a_cross_entropy_search_is_cheaper(arcs, direction):
    """Over the constants of a good structure; on a straight road it comes within 2 %."""
    scenario, speed = scenario_of(arcs=arcs), np.full(100, 13.0)
    start = curved_start(scenario, speed=13.0, position=115.0, direction=direction)
    bound = -optimal_lane_change(scenario, speed, **start).total_return
    rng = np.random.default_rng(0)
    mean, spread = np.array([1.5, 0.7, 0.5, 0.12, 0.02]), np.array([0.3, 0.1, 0.1, 0.04, 0.01])
    cheapest = math.inf
    for _ in range(6):
        gains = np.abs(mean + spread * rng.standard_normal((25, 5))) + 1e-3
        costs = np.array([cascade_cost(scenario, speed, start, row) for row in gains])
        best = np.argsort(costs)[:6]
        mean, spread = gains[best].mean(axis=0), gains[best].std(axis=0) + 1e-3
        cheapest = min(cheapest, costs.min())
    assert cheapest < bound * (1.04 if not arcs else 2.0)
    assert cheapest >= bound


@CURVES
@pytest.mark.parametrize("direction", [1, -1])
def test_no_neighbor_of_the_optimum_is_cheaper(arcs, direction):
    """Random changes of a few actions that together keep the final state (almost)."""
    scenario, speed = scenario_of(arcs=arcs), np.full(100, 9.0)
    start = curved_start(scenario, speed=9.0, position=115.0, direction=direction)
    optimum = optimal_lane_change(scenario, speed, **start)
    replay, rng = replay_of(scenario, speed, start), np.random.default_rng(1)
    n, num_completed = optimum.num_steps, 0
    claimed = cost_until_completed(
        scenario, optimum.yaw_acceleration, replay.follow(optimum.yaw_acceleration)
    )
    assert claimed == pytest.approx(-optimum.total_return, rel=1e-12)
    _, response = replay.linearise(n)
    for _ in range(3000):
        changed = np.sort(rng.choice(n, 5, replace=False))
        # Unchanged: the three quantities after the last step.
        _, _, kept = np.linalg.svd(response[:, n - 1, changed])
        actions = optimum.yaw_acceleration.copy()
        size = 10.0 ** rng.uniform(-5.0, -1.0)
        actions[changed] += size * (kept[3:].T @ rng.standard_normal(len(kept) - 3))
        actions = np.clip(actions, -0.5, 0.5)
        cost = cost_until_completed(scenario, actions, replay.follow(actions))
        num_completed += math.isfinite(cost)
        assert cost >= claimed * (1.0 - 2e-6)
    assert num_completed > 300


@pytest.mark.slow
@CURVES
@pytest.mark.parametrize("direction", [1, -1])
def test_other_beginnings_of_the_search_end_no_lower(arcs, direction):
    """From random actions, at every third duration around the optimum's."""
    scenario, speed = scenario_of(arcs=arcs), np.full(160, 13.0)
    start = curved_start(scenario, speed=13.0, position=115.0, direction=direction)
    optimum = optimal_lane_change(scenario, speed, **start)
    rng, num_found = np.random.default_rng(2), 0
    for n in range(max(20, optimum.num_steps - 24), optimum.num_steps + 25, 3):
        search = module._Search(scenario, replay_of(scenario, speed, start))
        waves = rng.standard_normal(4) @ np.sin(
            np.outer(np.arange(1, 5), np.linspace(0.0, math.pi, n))
        )
        try:
            found = search.refine(n, 0.05 * waves)
        except (RuntimeError, ValueError):
            continue
        num_found += 1
        assert found.total_return <= optimum.total_return + 3e-6 * abs(optimum.total_return)
    assert num_found >= 10


# Symmetries and limits


@pytest.mark.parametrize("radius", [500.0, -100.0])
def test_mirrored_roads_cost_the_same(radius):
    """A change to the left on one road is the mirrored change to the right on the other."""
    found = []
    for sign in (1, -1):
        arc = {"start": 150.0, "end": 450.0, "radius": sign * radius, "transition": 50.0}
        start = {"deviation": 3.0, "yaw": 0.02, "yaw_rate": 0.03, "position": 140.0}
        start |= {"direction": sign, "lateral_position": sign * 1.0}
        found.append(optimal_lane_change(scenario_of(arcs=[arc]), np.full(60, 13.0), **start))
    assert found[1].total_return == pytest.approx(found[0].total_return, rel=1e-9)
    np.testing.assert_allclose(found[1].yaw_acceleration, found[0].yaw_acceleration, atol=1e-6)


def test_inside_a_wide_curve_the_change_costs_about_what_the_straight_does():
    """With a radius of 10 km the turning differs by 0.04 % from lane to lane."""
    arcs = [{"start": 0.0, "end": 900.0, "radius": 1e4, "transition": 0.0}]
    start = curved_start(scenario_of(arcs=arcs), speed=20.0, position=100.0, direction=1)
    bent = optimal_lane_change(scenario_of(arcs=arcs), np.full(60, 20.0), **start)
    assert bent.total_return == pytest.approx(lane_change(np.full(60, 20.0)).total_return, rel=2e-3)


def test_each_weight_scales_its_own_term():
    speed = np.full(40, 20.0)
    weights = {"yaw_acceleration_weight": 4.0, "yaw_rate_weight": 1.0, "deviation_weight": 0.1}
    base = lane_change(speed, PASSING).total_return
    doubled = lane_change(speed, PASSING, reward=weights)
    assert doubled.total_return == pytest.approx(2.0 * base)
    # Only the deviation costs, so the optimum is the fastest change within the action's bound.
    weights |= {"yaw_acceleration_weight": 0.0, "yaw_rate_weight": 0.0}
    fastest = lane_change(speed, PASSING, reward=weights)
    scenario = scenario_of(PASSING)
    start = {"deviation": LANE_WIDTH, "yaw_rate": 0.0, "direction": 1}
    start |= {"position": 0.0, "lateral_position": 0.0}
    known = replay_of(scenario, speed, start).follow(fastest.yaw_acceleration)
    expected = (0.1 * np.abs(known[DEVIATION]) / 1.875).sum()
    assert fastest.total_return == pytest.approx(-expected, rel=1e-6)
    assert fastest.num_steps < 26


def test_already_there_costs_one_free_step():
    optimum = lane_change(np.full(10, 20.0), deviation=0.0)
    assert optimum.num_steps == 1
    assert optimum.total_return == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"speed": []}, r"speed has shape \(0,\); it must be \(K,\), at least one step"),
        ({"speed": [[20.0]]}, r"speed has shape \(1, 1\)"),
        ({"speed": [20.0, math.nan]}, r"speed\[1\] is nan; it must be finite and not negative"),
        ({"speed": [-1.0]}, r"speed\[0\] is -1.0; it must be finite and not negative"),
        ({"initial_speed": -2.0}, "initial_speed is -2.0; it must be finite and not negative"),
        ({"direction": 0}, "direction is 0; it must be 1 or -1"),
        ({"position": math.inf}, "position is inf; it must be finite"),
        ({"lateral_position": math.nan}, "lateral_position is nan; it must be finite"),
        ({"deviation": math.nan}, "deviation is nan; it must be finite"),
        ({"yaw": math.inf}, "yaw is inf; it must be finite"),
        ({"yaw_rate": -math.inf}, "yaw_rate is -inf; it must be finite"),
    ],
)
def test_refused_input(changes, message):
    speed = changes.pop("speed", [20.0, 20.0])
    with pytest.raises(ValueError, match=f"^{message}"):
        lane_change(speed, PASSING, **changes)


@pytest.mark.parametrize("speed", [np.zeros(20), np.full(20, 0.01)], ids=["standing", "creeping"])
def test_out_of_reach(speed):
    with pytest.raises(ValueError, match=r"^deviation is 3\.75 m; .* must .* within 220 steps"):
        lane_change(speed, PASSING, action={"max_yaw_acceleration": 0.01})
