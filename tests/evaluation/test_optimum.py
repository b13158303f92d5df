"""The optimum against a primal program, the simulator, and searches for a better one."""

import math

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.optimize import linprog

from marl_lanes.evaluation import optimum as module
from marl_lanes.evaluation.measures import STEERING_COSTS
from marl_lanes.evaluation.optimum import Optimum, optimal_lane_change
from marl_lanes.evaluation.replay import DEVIATION, LATERAL_SPEED, YAW_RATE, Replay
from marl_lanes.evaluation.simplex import minimise
from marl_lanes.scenario import Scenario, load_scenario
from marl_lanes.traffic.machine.state import Outcome
from marl_lanes.traffic.parameters import make_parameters
from marl_lanes.traffic.road.geometry import curvature_at
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.traffic.simulator import Simulator

TIME_STEP = 0.1
LANE_WIDTH = 3.75
PASSING = {"max_deviation": 0.2, "max_lateral_speed": None, "max_yaw_rate": None}
SETTLED = {"max_deviation": 0.2, "max_lateral_speed": 0.25, "max_yaw_rate": 0.03}
ENDS = pytest.mark.parametrize("completion", [PASSING, SETTLED], ids=["passing", "settled"])

PROFILES = {
    "constant": np.full(36, 18.0),
    "accelerating": np.linspace(12.0, 20.0, 40),
    "decelerating": np.linspace(28.0, 14.0, 30),
    "braking then accelerating": 20.0 + np.abs(np.linspace(-4.0, 4.0, 45)),
}
SPEEDS = pytest.mark.parametrize("profile", PROFILES.values(), ids=PROFILES.keys())

ROADS = {
    "straight": [],
    "wide": [{"start": 150.0, "end": 450.0, "radius": 500.0, "transition": 100.0}],
    "right": [{"start": 150.0, "end": 450.0, "radius": -100.0, "transition": 50.0}],
    "sharp": [{"start": 120.0, "end": 300.0, "radius": 50.0, "transition": 60.0}],
    "step": [{"start": 160.0, "end": 300.0, "radius": -120.0, "transition": 0.0}],
    "s": [
        {"start": 130.0, "end": 190.0, "radius": 100.0, "transition": 30.0},
        {"start": 190.0, "end": 260.0, "radius": -100.0, "transition": 30.0},
    ],
}
CURVES = pytest.mark.parametrize("arcs", ROADS.values(), ids=ROADS.keys())


def scenario_of(completion=SETTLED, arcs=(), **overrides) -> Scenario:
    given = {"completion": completion, "road": {"arcs": list(arcs)}, **overrides}
    return load_scenario("paper", given)


def lane_change(speed, completion=SETTLED, **changes) -> Optimum:
    """On a straight road, one lane away, without yaw and yaw rate, except for the changes."""
    fields = {name: changes.pop(name) for name in ("reward", "action") if name in changes}
    start = {"deviation": LANE_WIDTH} | changes
    return optimal_lane_change(scenario_of(completion, **fields), speed, **start)


def curved_start(scenario: Scenario, *, speed: float, position: float, direction: int) -> dict:
    """In the middle lane, turning with the road."""
    lateral = 1.5 * LANE_WIDTH
    curvature = curvature_at(make_parameters(scenario).arcs, position)
    return {
        "deviation": LANE_WIDTH,
        "yaw_rate": direction * curvature * speed / (1.0 - curvature * lateral),
        "direction": direction,
        "position": position,
        "lateral_position": lateral,
    }


def replay_of(scenario: Scenario, speed: np.ndarray, start: dict) -> Replay:
    whole = {"initial_speed": float(speed[0]), "yaw": 0.0} | start
    return Replay(make_parameters(scenario), speed, **whole)


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


def primal_cost(
    speed: np.ndarray, num_steps: int, completion: dict, max_yaw_acceleration: float = 0.5
) -> float:
    """Oracle for small angles: states as variables, each cost term split into two parts >= 0."""
    n = num_steps
    v = np.append(speed, np.full(max(0, n - speed.size), speed[-1]))[:n]
    identity = sp.identity(n, format="csr")
    difference = identity - sp.eye(n, k=-1, format="csr")
    # Columns: action, yaw rate and deviation, each as +part, -part; then yaw.
    rows = [
        [-TIME_STEP * identity, TIME_STEP * identity, difference, -difference, None, None, None],
        [None, None, -TIME_STEP * identity, TIME_STEP * identity, None, None, difference],
        [None, None, None, None, difference, -difference, sp.diags(TIME_STEP * v)],
    ]
    target = np.zeros(3 * n)
    target[2 * n] = LANE_WIDTH
    lower, upper = np.zeros(7 * n), np.full(7 * n, np.inf)
    lower[6 * n :] = -np.inf
    upper[: 2 * n] = max_yaw_acceleration
    upper[[5 * n - 1, 6 * n - 1]] = completion["max_deviation"]
    if completion["max_lateral_speed"] is not None:
        upper[-1] = completion["max_lateral_speed"] / v[-1]
        lower[-1] = -upper[-1]
    if completion["max_yaw_rate"] is not None:
        upper[[3 * n - 1, 4 * n - 1]] = completion["max_yaw_rate"]
    weights = np.repeat([2.0, 0.5, 0.05 / 1.875, 0.0], [2 * n, 2 * n, 2 * n, n])
    result = linprog(
        weights,
        A_eq=sp.bmat(rows, format="csc"),
        b_eq=target,
        bounds=np.column_stack([lower, upper]),
        method="highs-ds",
        options={"presolve": False},
    )
    assert result.status in {0, 2}
    return float(result.fun) if result.status == 0 else math.inf


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


# The simulator


def alone_and_engaged(speed, desired, arcs, seed):
    """A simulator with one engaged changer and no vehicle near it."""
    fixed = {
        "departures": {
            "interval": [300.0, 300.0],
            "initial_speed": [speed, speed],
            "desired_speed": [desired, desired],
        },
        "command": {"probability": 1.0, "position": [100.0, 100.0]},
        "warmup": [0.0, 0.0],
    }
    simulator = Simulator(scenario_of(arcs=arcs, **fixed), seed=seed)
    simulator.reset()
    while not simulator.is_steering.any():
        simulator.step()
    return simulator


def drive(simulator, actions):
    """Sum of rewards, steps and outcome of the actions, then of zeros."""
    total, given = 0.0, np.zeros((1, simulator.num_slots, 1))
    slot = int(np.argmax(simulator.is_steering[0]))
    for step in range(400):
        given[:] = actions[step] if step < len(actions) else 0.0
        simulator.step(given)
        agent = simulator.agents[0, slot]
        total += sum(CHANGER.terms_of(agent)[f"reward_{x}"] for x in STEERING_COSTS)
        if agent["outcome"] != Outcome.UNFINISHED:
            return total, step + 1, Outcome(int(agent["outcome"]))
    raise AssertionError("the command does not end")


DRIVEN = [(name, 8.5, 8.5) for name in ROADS]
DRIVEN += [("straight", 28.0, 28.0), ("straight", 8.0, 25.0), ("wide", 25.0, 25.0)]
DRIVEN += [("right", 13.0, 13.0), ("step", 13.0, 13.0)]


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize(("road", "initial", "desired"), DRIVEN)
def test_the_actions_complete_in_the_simulator_at_the_cost_that_is_claimed(
    road, initial, desired, seed
):
    simulator = alone_and_engaged(initial, desired, ROADS[road], seed)
    agent = simulator.agents[0][simulator.is_steering[0]][0]
    car = simulator.vehicles[0, agent["vehicle"]]
    sign, centre = int(agent["direction"]), (agent["target_lane"] + 0.5) * LANE_WIDTH
    start = {
        "deviation": sign * float(centre - car["lateral_position"]),
        "yaw": sign * float(car["yaw"]),
        "yaw_rate": sign * float(car["yaw_rate"]),
        "direction": sign,
        "initial_speed": float(car["speed"]),
        "position": float(car["position"]),
        "lateral_position": float(car["lateral_position"]),
    }
    speed = np.full(120, initial)
    if initial != desired:
        state = simulator.snapshot()
        for k in range(120):
            simulator.step()
            speed[k] = car["speed"]
        assert speed[-1] > initial + 5.0
        simulator.restore(state)
    optimum = optimal_lane_change(simulator.scenario, speed, **start)
    total, num_steps, outcome = drive(simulator, optimum.yaw_acceleration)
    assert outcome == Outcome.COMPLETED
    assert num_steps == optimum.num_steps
    assert total == pytest.approx(optimum.total_return, rel=1e-9)


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


def test_the_simplex_method_finds_what_linprog_finds():
    """Random sums of |x| with bounds, feasible by construction or infeasible."""
    rng = np.random.default_rng(3)
    num_infeasible = 0
    for _ in range(60):
        n, m = int(rng.integers(1, 12)), int(rng.integers(1, 20))
        response = rng.standard_normal((m, n))
        free = rng.standard_normal(m) * rng.integers(0, 2, m)
        weights = rng.uniform(0.0, 2.0, n + m) * rng.integers(0, 2, n + m)
        bounds = np.where(rng.random(n + m) < 0.4, rng.uniform(0.1, 1.5, n + m), np.inf)
        found = minimise(free, response, weights, bounds)
        values = np.abs(np.concatenate([found, free + response @ found]))
        # |x| <= u: the unknowns are a, then u.
        rows = np.vstack([np.eye(n), response])
        both = np.block([[rows, -np.eye(n + m)], [-rows, -np.eye(n + m)]])
        offset = np.concatenate([np.zeros(n), free])
        limits = [(None, None)] * n + [(0.0, bound) for bound in bounds]
        given = np.concatenate([np.zeros(n), weights])
        expected = linprog(given, A_ub=both, b_ub=np.concatenate([-offset, offset]), bounds=limits)
        if expected.status == 2:
            num_infeasible += 1
            assert (values > bounds + 1e-6).any()
        else:
            assert (values <= bounds + 1e-7).all()
            assert weights @ values == pytest.approx(expected.fun, rel=1e-7, abs=1e-7)
    assert 5 < num_infeasible < 55


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
        lane_change(speed, PASSING, action={"max_yaw_acceleration": 0.001})
