"""Lane changes on straight and curved roads, and a second program for their cost."""

import math

import numpy as np
import scipy.sparse as sp
from scipy.optimize import linprog

from marl_lanes.evaluation.optimum import Optimum, optimal_lane_change
from marl_lanes.evaluation.replay import Replay
from marl_lanes.scenario import Scenario, load_scenario
from marl_lanes.traffic.parameters import make_parameters
from marl_lanes.traffic.road.geometry import curvature_at

TIME_STEP = 0.1
LANE_WIDTH = 3.75
PASSING = {"max_deviation": 0.2, "max_lateral_speed": None, "max_yaw_rate": None}
SETTLED = {"max_deviation": 0.2, "max_lateral_speed": 0.25, "max_yaw_rate": 0.03}

PROFILES = {
    "constant": np.full(36, 18.0),
    "accelerating": np.linspace(12.0, 20.0, 40),
    "decelerating": np.linspace(28.0, 14.0, 30),
    "braking then accelerating": 20.0 + np.abs(np.linspace(-4.0, 4.0, 45)),
}

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
