"""The optimum against an independent primal program, a replay, and the known returns."""

import math
from collections.abc import Callable

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.optimize import linprog

from marl_lanes.evaluation.optimum import Optimum, optimal_lane_change
from marl_lanes.scenario.schema import Completion, Reward

TIME_STEP = 0.1
LANE_WIDTH = 3.75
REWARD = Reward(
    acceleration_weight=2.0, yaw_rate_weight=0.5, deviation_weight=0.05, average_deviation=1.875
)
PASSING = Completion(max_deviation=0.2)
SETTLED = Completion(max_deviation=0.2, max_lateral_speed=0.25, max_yaw_rate=0.03)

PROFILES = {
    "constant": np.full(36, 18.0),
    "accelerating": np.linspace(12.0, 20.0, 40),
    "decelerating": np.linspace(28.0, 14.0, 30),
    "braking then accelerating": 20.0 + np.abs(np.linspace(-4.0, 4.0, 45)),
}


def lane_change(speed: np.ndarray, completion: Completion, **changes: object) -> Optimum:
    arguments: dict[str, object] = {
        "time_step": TIME_STEP,
        "deviation": LANE_WIDTH,
        "max_yaw_acceleration": 0.5,
        "reward": REWARD,
    }
    return optimal_lane_change(speed, completion=completion, **(arguments | changes))  # type: ignore[arg-type]


def replay(
    optimum: Optimum,
    speed: np.ndarray,
    *,
    deviation: float = LANE_WIDTH,
    yaw: float = 0.0,
    yaw_rate: float = 0.0,
    curvature: np.ndarray | float = 0.0,
    sine: Callable[[float], float] = float,
) -> tuple[float, list[tuple[float, float, float]]]:
    """Cost of the actions, and (deviation, lateral speed, yaw rate to the road) after each step."""
    curvatures = np.broadcast_to(curvature, speed.shape)
    cost, states = 0.0, []
    for k, action in enumerate(optimum.yaw_acceleration):
        v = float(speed[min(k, speed.size - 1)])
        turn_rate = float(curvatures[min(k, speed.size - 1)]) * v
        yaw_rate += action * TIME_STEP
        turning = yaw_rate - turn_rate
        yaw += turning * TIME_STEP
        deviation -= v * sine(yaw) * TIME_STEP
        cost += 2.0 * abs(action) + 0.5 * abs(turning) + 0.05 * abs(deviation) / 1.875
        states.append((deviation, v * sine(yaw), turning))
    return cost, states


def is_completed(
    state: tuple[float, float, float], completion: Completion, slack: float = 0.0
) -> bool:
    bounds = (completion.max_deviation, completion.max_lateral_speed, completion.max_yaw_rate)
    return all(
        bound is None or abs(value) <= bound + slack
        for value, bound in zip(state, bounds, strict=True)
    )


def primal_cost(
    speed: np.ndarray, num_steps: int, completion: Completion, max_yaw_acceleration: float = 0.5
) -> float:
    """Oracle: states as variables, each cost term split into a positive and a negative part."""
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
    upper[[5 * n - 1, 6 * n - 1]] = completion.max_deviation
    if completion.max_lateral_speed is not None:
        upper[-1] = completion.max_lateral_speed / v[-1]
        lower[-1] = -upper[-1]
    if completion.max_yaw_rate is not None:
        upper[[3 * n - 1, 4 * n - 1]] = completion.max_yaw_rate
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
def test_known_returns(
    speed: float, completion: Completion, expected: float, num_steps: int
) -> None:
    optimum = lane_change(np.full(40, speed), completion)

    assert optimum.total_return == pytest.approx(expected, rel=0.01)
    assert abs(optimum.num_steps - num_steps) <= 1  # The cost is flat there.
    assert optimum.yaw_acceleration.shape == (optimum.num_steps,)
    assert optimum.yaw_acceleration.dtype == np.float64


@pytest.mark.parametrize("completion", [PASSING, SETTLED], ids=["passing", "settled"])
@pytest.mark.parametrize("profile", PROFILES.values(), ids=PROFILES.keys())
def test_search_finds_what_a_scan_of_every_duration_finds(
    profile: np.ndarray, completion: Completion
) -> None:
    costs = {n: primal_cost(profile, n, completion) for n in range(16, 91)}
    cheapest = min(costs, key=costs.__getitem__)

    optimum = lane_change(profile, completion)

    assert 16 < cheapest < 90
    assert optimum.num_steps == cheapest
    assert optimum.total_return == pytest.approx(-costs[cheapest], rel=1e-6)


@pytest.mark.parametrize("num_recorded", [5, 20, 45, 250])
def test_recorded_duration_does_not_matter(num_recorded: int) -> None:
    optimum = lane_change(np.full(num_recorded, 22.0), SETTLED)
    assert optimum.num_steps in {59, 60, 61}


def test_binding_action_bound() -> None:
    speed = np.full(40, 20.0)
    costs = {n: primal_cost(speed, n, PASSING, max_yaw_acceleration=0.15) for n in range(20, 60)}
    optimum = lane_change(speed, PASSING, max_yaw_acceleration=0.15)

    assert np.abs(optimum.yaw_acceleration).max() == pytest.approx(0.15, abs=1e-9)
    assert optimum.total_return == pytest.approx(-min(costs.values()), rel=1e-6)
    assert optimum.total_return < lane_change(speed, PASSING).total_return - 1e-3


@pytest.mark.parametrize("completion", [PASSING, SETTLED], ids=["passing", "settled"])
@pytest.mark.parametrize("profile", PROFILES.values(), ids=PROFILES.keys())
@pytest.mark.parametrize("sine", [float, math.sin], ids=["linear", "nonlinear"])
def test_replayed_actions_cost_what_is_claimed_and_complete(
    profile: np.ndarray, completion: Completion, sine: Callable[[float], float]
) -> None:
    start = {"deviation": 3.6, "yaw": 0.01, "yaw_rate": -0.02}
    curvature = np.linspace(-0.002, 0.003, profile.size)
    optimum = lane_change(profile, completion, curvature=curvature, **start)

    cost, states = replay(optimum, profile, curvature=curvature, sine=sine, **start)

    is_linear = sine is float
    assert -cost == pytest.approx(optimum.total_return, rel=1e-6 if is_linear else 0.005)
    assert is_completed(states[-1], completion, slack=1e-6 if is_linear else 0.02)
    if is_linear:
        # An earlier completion would be a cheaper candidate.
        assert not any(is_completed(state, completion, slack=-1e-6) for state in states[:-1])
    assert np.abs(optimum.yaw_acceleration).max() <= 0.5


@pytest.mark.parametrize("curvature", [0.004, -0.004, np.full(40, 0.004)])
def test_constant_curve_with_matching_yaw_rate_costs_what_the_straight_does(
    curvature: np.ndarray | float,
) -> None:
    speed = np.full(40, 20.0)
    straight = lane_change(speed, PASSING)
    curved = lane_change(
        speed, PASSING, curvature=curvature, yaw_rate=float(np.mean(curvature)) * 20.0
    )

    assert curved.total_return == pytest.approx(straight.total_return, rel=1e-9)
    assert curved.num_steps == straight.num_steps


def test_mirrored_start_mirrors_the_actions() -> None:
    speed, curvature = np.linspace(18.0, 22.0, 40), np.linspace(0.0, 0.002, 40)
    left = lane_change(speed, SETTLED, yaw=0.02, yaw_rate=0.03, curvature=curvature)
    right = lane_change(
        speed, SETTLED, deviation=-LANE_WIDTH, yaw=-0.02, yaw_rate=-0.03, curvature=-curvature
    )

    assert right.total_return == pytest.approx(left.total_return, rel=1e-9)
    assert right.num_steps == left.num_steps
    np.testing.assert_allclose(right.yaw_acceleration, -left.yaw_acceleration, atol=1e-7)


def test_each_weight_scales_its_own_term() -> None:
    speed = np.full(40, 20.0)
    doubled = Reward(
        acceleration_weight=4.0, yaw_rate_weight=1.0, deviation_weight=0.1, average_deviation=1.875
    )
    free_action = Reward(
        acceleration_weight=0.0, yaw_rate_weight=0.0, deviation_weight=0.1, average_deviation=1.875
    )
    base = lane_change(speed, PASSING).total_return

    assert lane_change(speed, PASSING, reward=doubled).total_return == pytest.approx(2.0 * base)
    # What is left is the deviation, and the fastest change under the action's bound.
    fastest = lane_change(speed, PASSING, reward=free_action)
    _, states = replay(fastest, speed)
    expected = sum(0.1 * abs(deviation) / 1.875 for deviation, _, _ in states)
    assert fastest.total_return == pytest.approx(-expected, rel=1e-6)
    assert fastest.num_steps < 26


def test_already_there_costs_one_free_step() -> None:
    optimum = lane_change(np.full(10, 20.0), SETTLED, deviation=0.0)
    assert optimum.num_steps == 1
    assert optimum.total_return == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"speed": []}, r"speed has shape \(0,\); it must be \(K,\), at least one step"),
        ({"speed": [[20.0]]}, r"speed has shape \(1, 1\)"),
        ({"speed": [20.0, math.nan]}, r"speed\[1\] is nan; it must be finite and not negative"),
        ({"speed": [-1.0]}, r"speed\[0\] is -1.0; it must be finite and not negative"),
        ({"curvature": [0.0]}, r"curvature has shape \(1,\); it must be a number or \(2,\)"),
        ({"curvature": [0.0, math.inf]}, r"curvature\[1\] is inf; it must be finite"),
        ({"time_step": 0.0}, "time_step is 0.0; it must be finite and positive"),
        ({"max_yaw_acceleration": math.inf}, "max_yaw_acceleration is inf; it must be finite"),
        ({"deviation": math.nan}, "deviation is nan; it must be finite"),
        ({"yaw": math.inf}, "yaw is inf; it must be finite"),
        ({"yaw_rate": -math.inf}, "yaw_rate is -inf; it must be finite"),
    ],
)
def test_refused_input(changes: dict[str, object], message: str) -> None:
    speed = changes.pop("speed", [20.0, 20.0])
    with pytest.raises(ValueError, match=f"^{message}"):
        lane_change(speed, PASSING, **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize("speed", [np.zeros(20), np.full(20, 0.01)], ids=["standing", "creeping"])
def test_out_of_reach(speed: np.ndarray) -> None:
    with pytest.raises(ValueError, match=r"^deviation is 3\.75 m; it must be one .* 220 steps"):
        lane_change(speed, PASSING, max_yaw_acceleration=0.001)
