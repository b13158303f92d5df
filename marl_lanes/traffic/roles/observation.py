"""Named features of an agent, in the maneuver frame: positive toward the target lane."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from marl_lanes.traffic.command.phases import lateral_deviation
from marl_lanes.traffic.driving.acceleration import car_following
from marl_lanes.traffic.machine.compiled import internal
from marl_lanes.traffic.machine.state import NONE
from marl_lanes.traffic.road.geometry import curvature_at
from marl_lanes.traffic.road.neighbors import bumper_gap


class Feature(NamedTuple):
    """One row of FEATURES."""

    name: str
    unit: str
    offset: float
    """Typical centre, for networks."""
    scale: float
    """Typical spread, for networks."""
    low: float
    high: float
    meaning: str


FEATURES = (
    Feature("speed", "m/s", 20.0, 10.0, 0.0, 150.0, "along the heading"),
    Feature("acceleration", "m/s^2", 0.0, 2.0, -20.0, 20.0, "longitudinal, of the last step"),
    Feature("lateral_deviation", "m", 0.0, 1.0, -100.0, 100.0, "to the reference lane's centre"),
    Feature("lateral_speed", "m/s", 0.0, 0.5, -150.0, 150.0, "v sin(yaw)"),
    Feature("yaw", "rad", 0.0, 0.03, -math.pi, math.pi, "relative to the road"),
    Feature("yaw_rate", "rad/s", 0.0, 0.03, -150.0, 150.0, "the road's own turning included"),
    Feature("curvature", "1/m", 0.0, 0.002, -0.02, 0.02, "positive bends toward the target lane"),
    Feature("leader_gap", "m", 50.0, 50.0, -20.0, 1e4, "to the one ahead in the origin lane"),
    Feature("leader_relative_speed", "m/s", 0.0, 5.0, -150.0, 150.0, "its speed minus the own"),
    Feature("follower_gap", "m", 50.0, 50.0, -20.0, 1e4, "to the one behind in the origin lane"),
    Feature("follower_relative_speed", "m/s", 0.0, 5.0, -150.0, 150.0, "its speed minus the own"),
    Feature("target_leader_gap", "m", 50.0, 50.0, -20.0, 1e4, "ahead in the target lane"),
    Feature(
        "target_leader_relative_speed", "m/s", 0.0, 5.0, -150.0, 150.0, "its speed minus the own"
    ),
    Feature("target_follower_gap", "m", 50.0, 50.0, -20.0, 1e4, "behind in the target lane"),
    Feature(
        "target_follower_relative_speed", "m/s", 0.0, 5.0, -150.0, 150.0, "its speed minus the own"
    ),
    Feature("phase", "1", 2.0, 1.0, 0.0, 3.0, "1 waiting, 2 engaged, 3 aborting"),
    Feature("time", "s", 10.0, 10.0, 0.0, 1e6, "since the command"),
    Feature(
        "car_following_acceleration", "m/s^2", 0.0, 2.0, -20.0, 20.0, "what car following would do"
    ),
    Feature("distance_to_end", "m", 500.0, 500.0, -100.0, 1e5, "to the road's end"),
)
"""Every feature that a scenario may name. Where there is no neighbor its gap is the scenario's
``sensor_range``, at which gaps are cut off, and its relative speed 0."""

FOLLOWER_FEATURES = (
    Feature("speed", "m/s", 20.0, 10.0, 0.0, 150.0, "own, along the heading"),
    Feature("acceleration", "m/s^2", 0.0, 2.0, -20.0, 20.0, "own, of the last step"),
    Feature("gap", "m", 20.0, 20.0, -20.0, 1e4, "to the changer"),
    Feature("relative_speed", "m/s", 0.0, 5.0, -150.0, 150.0, "the changer's speed minus the own"),
    Feature("changer_lateral_deviation", "m", 0.0, 2.0, -100.0, 100.0, "of the changer"),
    Feature("changer_lateral_speed", "m/s", 0.0, 0.5, -150.0, 150.0, "toward the target lane"),
    Feature("leader_gap", "m", 50.0, 50.0, -20.0, 1e4, "to the one ahead in the own lane"),
    Feature("leader_relative_speed", "m/s", 0.0, 5.0, -150.0, 150.0, "its speed minus the own"),
    Feature("phase", "1", 2.0, 1.0, 0.0, 3.0, "the changer's: 1 waiting, 2 engaged, 3 aborting"),
)
"""The columns of a follower's observation, in order. The one ahead in the own lane is the changer's
target leader; where there is none, gap and relative speed are as for FEATURES."""

_NAMES = tuple(feature.name for feature in FEATURES)
_FIRST_NEIGHBOR = _NAMES.index("leader_gap")
_PHASE = _NAMES.index("phase")
_TIME = _NAMES.index("time")
_CAR_FOLLOWING = _NAMES.index("car_following_acceleration")
_DISTANCE = _NAMES.index("distance_to_end")


def feature_codes(names: Sequence[str]) -> NDArray[np.int32]:
    """Rows of FEATURES for the names, (F,) int32."""
    return np.asarray([_NAMES.index(name) for name in names], np.int32)


def feature_scaling(names: Sequence[str]) -> tuple[list[float], list[float]]:
    """Offsets and scales of the named features, so that (x - offset)/scale is of order one."""
    rows = [FEATURES[code] for code in feature_codes(names)]
    return [row.offset for row in rows], [row.scale for row in rows]


def feature_bounds(names: Sequence[str]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Lowest and highest values of the named features, two (F,) float32."""
    return _bounds([FEATURES[code] for code in feature_codes(names)])


def follower_feature_bounds() -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Lowest and highest values of a follower's observation, two (G,) float32."""
    return _bounds(FOLLOWER_FEATURES)


def _bounds(rows: Sequence[Feature]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    low = np.asarray([row.low for row in rows], np.float32)
    return low, np.asarray([row.high for row in rows], np.float32)


@internal
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


@internal
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


@internal
def observe(
    agent: Any,
    road: Any,
    vehicles: Any,
    order: Any,
    agents: Any,
    arcs: Any,
    features: Any,
    constants: Any,
    profiles: Any,
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
        elif code == _CAR_FOLLOWING:
            value = car_following(
                agent, order, road.num_vehicles, vehicles, agents, profiles, arcs, constants
            )
        elif code == _DISTANCE:
            value = constants.road_length - car.position
        else:
            value = _neighbor_feature(code, agent, car, vehicles, constants)
        observation[column] = value


@internal
def observe_follower(agent: Any, vehicles: Any, constants: Any, observation: Any) -> None:
    """Write FOLLOWER_FEATURES of the changer's target follower, (G,) float32; zeros without one."""
    if agent.target_follower == NONE:
        observation[:] = 0.0
        return
    driver, changer = vehicles[agent.target_follower], vehicles[agent.vehicle]
    leader_gap, leader_relative_speed = constants.sensor_range, 0.0
    if agent.target_leader > NONE:
        leader = vehicles[agent.target_leader]
        leader_gap = min(bumper_gap(driver, leader, constants), leader_gap)
        leader_relative_speed = leader.speed - driver.speed
    observation[0] = driver.speed
    observation[1] = driver.acceleration
    observation[2] = min(bumper_gap(driver, changer, constants), constants.sensor_range)
    observation[3] = changer.speed - driver.speed
    observation[4] = lateral_deviation(agent, changer, constants)
    observation[5] = agent.direction * changer.speed * math.sin(changer.yaw)
    observation[6] = leader_gap
    observation[7] = leader_relative_speed
    observation[8] = agent.phase
