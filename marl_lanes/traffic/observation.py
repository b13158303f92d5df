"""Named features of an agent, in the maneuver frame: positive toward the target lane."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from marl_lanes.traffic.compiled import compiled
from marl_lanes.traffic.kinematics import curvature_at
from marl_lanes.traffic.maneuver import lateral_deviation
from marl_lanes.traffic.state import NONE

FEATURES: tuple[tuple[str, str, float, float, str], ...] = (
    ("speed", "m/s", 20.0, 10.0, "along the heading"),
    ("acceleration", "m/s^2", 0.0, 2.0, "longitudinal, of the last step"),
    ("lateral_deviation", "m", 0.0, 2.0, "from the vehicle to the reference lane's centre"),
    ("lateral_speed", "m/s", 0.0, 1.0, "v sin(yaw)"),
    ("yaw", "rad", 0.0, 0.05, "relative to the road"),
    ("yaw_rate", "rad/s", 0.0, 0.05, "the road's own turning included"),
    ("curvature", "1/m", 0.0, 0.002, "of the road; positive bends toward the target lane"),
    ("leader_gap", "m", 50.0, 50.0, "to the one ahead in the origin lane; sensor_range if none"),
    ("leader_relative_speed", "m/s", 0.0, 5.0, "its speed minus the own; 0 if none"),
    ("follower_gap", "m", 50.0, 50.0, "to the one behind in the origin lane; sensor_range if none"),
    ("follower_relative_speed", "m/s", 0.0, 5.0, "its speed minus the own; 0 if none"),
    ("target_leader_gap", "m", 50.0, 50.0, "the same in the target lane"),
    ("target_leader_relative_speed", "m/s", 0.0, 5.0, "the same in the target lane"),
    ("target_follower_gap", "m", 50.0, 50.0, "the same in the target lane"),
    ("target_follower_relative_speed", "m/s", 0.0, 5.0, "the same in the target lane"),
    ("phase", "1", 2.0, 1.0, "1 waiting, 2 engaged, 3 aborting"),
    ("time", "s", 10.0, 10.0, "since the command"),
)
"""Name, unit, offset and scale (typical centre and spread, for networks), meaning."""

_NAMES = tuple(row[0] for row in FEATURES)
_FIRST_NEIGHBOR = _NAMES.index("leader_gap")
_PHASE = _NAMES.index("phase")
_TIME = _NAMES.index("time")


def feature_codes(names: Sequence[str]) -> NDArray[np.int32]:
    """Rows of FEATURES for the names, (F,) int32."""
    return np.asarray([_NAMES.index(name) for name in names], np.int32)


def feature_scaling(names: Sequence[str]) -> tuple[list[float], list[float]]:
    """Offsets and scales of the named features, so that (x - offset)/scale is of order one."""
    rows = [FEATURES[code] for code in feature_codes(names)]
    return [row[2] for row in rows], [row[3] for row in rows]


@compiled
def _own_feature(code: int, agent: Any, car: Any, arcs: Any, constants: Any) -> float:
    direction = agent.direction
    if code == 0:
        return float(car.speed)
    if code == 1:
        return float(car.acceleration)
    if code == 2:
        return float(lateral_deviation(agent, car, constants))
    if code == 3:
        return float(direction * car.speed * math.sin(car.yaw))
    if code == 4:
        return float(direction * car.yaw)
    if code == 5:
        return float(direction * car.yaw_rate)
    return float(direction * curvature_at(arcs, car.position))


@compiled
def _neighbor_feature(code: int, agent: Any, car: Any, vehicles: Any, constants: Any) -> float:
    which, is_speed = divmod(code - _FIRST_NEIGHBOR, 2)
    if which == 0:
        other = agent.leader
    elif which == 1:
        other = agent.follower
    elif which == 2:
        other = agent.target_leader
    else:
        other = agent.target_follower
    if other == NONE:
        return 0.0 if is_speed else float(constants.sensor_range)
    neighbor = vehicles[other]
    if is_speed:
        return float(neighbor.speed - car.speed)
    gap = abs(neighbor.position - car.position) - constants.vehicle_length
    return float(min(gap, constants.sensor_range))


@compiled
def observe(
    agent: Any,
    vehicles: Any,
    road: Any,
    arcs: Any,
    features: Any,
    constants: Any,
    observation: Any,
) -> None:
    """Write the agent's features, (F,) float32, in the scenario's order."""
    car = vehicles[agent.vehicle]
    for column in range(features.shape[0]):
        code = features[column]
        if code < _FIRST_NEIGHBOR:
            value = _own_feature(code, agent, car, arcs, constants)
        elif code == _PHASE:
            value = float(agent.phase)
        elif code == _TIME:
            value = (road.step - agent.born_step) * constants.time_step
        else:
            value = _neighbor_feature(code, agent, car, vehicles, constants)
        observation[column] = value
