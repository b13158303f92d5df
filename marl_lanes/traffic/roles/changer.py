"""The changer: a vehicle that is commanded to change lanes, from the command to its outcome.

Lateral quantities are in the maneuver frame, positive toward the target lane. A feature's formula
has the agent's record, its vehicle and the ``Scene`` as arguments, a reward term's formula its
weight and the ``Step``.
"""

import math
from typing import Any, NamedTuple

from marl_lanes.scenario import Scenario
from marl_lanes.traffic.command.phases import is_steering, lateral_deviation
from marl_lanes.traffic.driving.acceleration import car_following
from marl_lanes.traffic.machine.compiled import internal
from marl_lanes.traffic.machine.state import AGENT, NONE, Outcome
from marl_lanes.traffic.road.geometry import curvature_at, wrap_angle
from marl_lanes.traffic.road.neighbors import mean_length
from marl_lanes.traffic.roles.grid import grid_columns, observe_grid
from marl_lanes.traffic.roles.role import (
    Dimension,
    Feature,
    Role,
    Term,
    make_observer,
    make_payment,
)

_COLLISION = int(Outcome.COLLISION)
_OFF_ROAD = int(Outcome.OFF_ROAD)


class Scene(NamedTuple):
    """A road with its parameters, as one argument of the features' formulas."""

    road: Any
    vehicles: Any
    order: Any
    agents: Any
    profiles: Any
    arcs: Any
    constants: Any


@internal
def _gap_to(other: int, car: Any, scene: Any) -> float:
    """Bumper-to-bumper gap, at most the sensor range; the sensor range without a neighbor [m]."""
    if other == NONE:
        return float(scene.constants.sensor_range)
    neighbor = scene.vehicles[other]
    distance = abs(neighbor.position - car.position)
    gap = distance - mean_length(car, neighbor, scene.profiles)
    return float(min(gap, scene.constants.sensor_range))


@internal
def _relative_speed(other: int, car: Any, scene: Any) -> float:
    """The neighbor's speed minus the agent's, 0 without a neighbor [m/s]."""
    if other == NONE:
        return 0.0
    return float(scene.vehicles[other].speed - car.speed)


@internal
def _car_following(agent: Any, scene: Any) -> float:
    return car_following(
        agent,
        scene.order,
        scene.road.num_vehicles,
        scene.vehicles,
        scene.agents,
        scene.profiles,
        scene.arcs,
        scene.constants,
    )


# A star puts the numbers of a row on one line.
FEATURES = (
    Feature(
        *("speed", "m/s", 20.0, 10.0, 0.0, 150.0),
        "along the heading",
        lambda agent, car, scene: car.speed,
    ),
    Feature(
        *("acceleration", "m/s^2", 0.0, 2.0, -20.0, 20.0),
        "longitudinal, of the last step",
        lambda agent, car, scene: car.acceleration,
    ),
    Feature(
        *("lateral_deviation", "m", 0.0, 1.0, -100.0, 100.0),
        "to the reference lane's centre",
        lambda agent, car, scene: lateral_deviation(agent, car, scene.constants),
    ),
    Feature(
        *("lateral_speed", "m/s", 0.0, 0.5, -150.0, 150.0),
        "v sin(yaw)",
        lambda agent, car, scene: agent.direction * car.speed * math.sin(car.yaw),
    ),
    Feature(
        *("yaw", "rad", 0.0, 0.03, -math.pi, math.pi),
        "relative to the road, in (-pi, pi]",
        lambda agent, car, scene: wrap_angle(agent.direction * car.yaw),
    ),
    Feature(
        *("yaw_rate", "rad/s", 0.0, 0.03, -150.0, 150.0),
        "the road's own turning included",
        lambda agent, car, scene: agent.direction * car.yaw_rate,
    ),
    Feature(
        *("curvature", "1/m", 0.0, 0.002, -0.02, 0.02),
        "positive bends toward the target lane",
        lambda agent, car, scene: agent.direction * curvature_at(scene.arcs, car.position),
    ),
    Feature(
        *("leader_gap", "m", 50.0, 50.0, -20.0, 1e4),
        "to the vehicle ahead in the origin lane",
        lambda agent, car, scene: _gap_to(agent.leader, car, scene),
    ),
    Feature(
        *("leader_relative_speed", "m/s", 0.0, 5.0, -150.0, 150.0),
        "its speed minus the own",
        lambda agent, car, scene: _relative_speed(agent.leader, car, scene),
    ),
    Feature(
        *("follower_gap", "m", 50.0, 50.0, -20.0, 1e4),
        "to the vehicle behind in the origin lane",
        lambda agent, car, scene: _gap_to(agent.follower, car, scene),
    ),
    Feature(
        *("follower_relative_speed", "m/s", 0.0, 5.0, -150.0, 150.0),
        "its speed minus the own",
        lambda agent, car, scene: _relative_speed(agent.follower, car, scene),
    ),
    Feature(
        *("target_leader_gap", "m", 50.0, 50.0, -20.0, 1e4),
        "ahead in the target lane",
        lambda agent, car, scene: _gap_to(agent.target_leader, car, scene),
    ),
    Feature(
        *("target_leader_relative_speed", "m/s", 0.0, 5.0, -150.0, 150.0),
        "its speed minus the own",
        lambda agent, car, scene: _relative_speed(agent.target_leader, car, scene),
    ),
    Feature(
        *("target_follower_gap", "m", 50.0, 50.0, -20.0, 1e4),
        "behind in the target lane",
        lambda agent, car, scene: _gap_to(agent.target_follower, car, scene),
    ),
    Feature(
        *("target_follower_relative_speed", "m/s", 0.0, 5.0, -150.0, 150.0),
        "its speed minus the own",
        lambda agent, car, scene: _relative_speed(agent.target_follower, car, scene),
    ),
    Feature(
        *("phase", "1", 2.0, 1.0, 0.0, 3.0),
        "1 waiting, 2 engaged, 3 aborting",
        lambda agent, car, scene: agent.phase,
    ),
    Feature(
        *("time", "s", 10.0, 10.0, 0.0, 1e6),
        "since the command",
        lambda agent, car, scene: (scene.road.step - agent.born_step) * scene.constants.time_step,
    ),
    Feature(
        *("car_following_acceleration", "m/s^2", 0.0, 2.0, -20.0, 20.0),
        "acceleration of car following in this state",
        lambda agent, car, scene: _car_following(agent, scene),
    ),
    Feature(
        *("distance_to_end", "m", 500.0, 500.0, -100.0, 1e5),
        "to the road's end",
        lambda agent, car, scene: scene.constants.road_length - car.position,
    ),
)
"""Every feature that a scenario may name, clipped to its bounds. Gaps are at most the scenario's
``sensor_range``. Without a neighbor the gap is ``sensor_range`` and the relative speed 0."""


class Step(NamedTuple):
    """The result of an agent's step, as one argument of the terms' formulas."""

    agent: Any
    car: Any
    deviation: float
    """Lateral deviation after the step [m]."""
    turning: float
    """Yaw rate after the step, relative to the road's turning [rad/s]."""
    outcome: int
    constants: Any


@internal
def _is_failure(outcome: int) -> bool:
    return outcome in (_COLLISION, _OFF_ROAD)


def _charge_departure(weight: float, step: Any) -> float:
    if not step.constants.has_longitudinal:
        return 0.0
    departure = step.car.acceleration - step.agent.car_following
    return float(-weight * departure * departure)


TERMS = (
    Term(
        *("yaw_acceleration", "yaw_acceleration_weight", "s^2/rad"),
        "Eq. 10: -w |a|, with the applied yaw acceleration a",
        lambda w, step: -w * abs(step.car.yaw_acceleration) if is_steering(step.agent) else 0.0,
        is_steering_cost=True,
    ),
    Term(
        *("yaw_rate", "yaw_rate_weight", "s/rad"),
        "Eq. 11: -w |omega - c s'|",
        lambda w, step: -w * abs(step.turning) if is_steering(step.agent) else 0.0,
        is_steering_cost=True,
    ),
    Term(
        *("deviation", "deviation_weight", "1"),
        "Eq. 12: -w |deviation|/d_avg",
        lambda w, step: (
            -w * abs(step.deviation) / step.constants.average_deviation
            if is_steering(step.agent)
            else 0.0
        ),
        is_steering_cost=True,
    ),
    Term(
        *("failure", "failure_penalty", "1"),
        "-w in the step of a collision or of leaving the road",
        lambda w, step: -w if _is_failure(step.outcome) else 0.0,
    ),
    Term(
        *("delay", "delay_weight", "1/s"),
        "-w dt, waiting included",
        lambda w, step: -w * step.constants.time_step,
    ),
    Term(
        *("longitudinal", "longitudinal_weight", "s^4/m^2"),
        "-w (a - a_following)^2, if there is a second action",
        _charge_departure,
    ),
)
"""The terms of a changer's reward. The first three count while it steers, the others always."""

_observe_now = make_observer(FEATURES)


@internal
def observe_changer(codes: Any, seen: Any, agent: Any, car: Any, scene: Any) -> None:
    """Set its newest observation, behind which the earlier ones move on; once in each step.

    At its command the earlier ones are copies of the first.
    """
    size = seen.shape[0] // scene.constants.num_stacked
    for column in range(seen.shape[0] - 1, size - 1, -1):
        seen[column] = seen[column - size]
    _observe_now(codes, seen, agent, car, scene)
    if size > codes.shape[0]:
        observe_grid(seen[codes.shape[0] : size], agent, car, scene)
    if agent.born_step == scene.road.step:
        for column in range(size, seen.shape[0]):
            seen[column] = seen[column - size]


pay_changer = make_payment(TERMS)


def _act(scenario: Scenario) -> tuple[Dimension, ...]:
    bound, longitudinal = scenario.action.max_yaw_acceleration, scenario.action.longitudinal
    steering = Dimension("yaw_acceleration", "rad/s^2", -bound, bound)
    if longitudinal is None:
        return (steering,)
    low, high = -longitudinal.max_braking, longitudinal.max_acceleration
    return steering, Dimension("acceleration", "m/s^2", low, high)


CHANGER = Role(
    name="changer",
    group="changers",
    table="agents",
    record=AGENT,
    observations="observations",
    features=FEATURES,
    terms=TERMS,
    see=lambda scenario: scenario.observation.features,
    beside=grid_columns,
    stack=lambda scenario: scenario.observation.num_stacked,
    act=_act,
    reward=lambda scenario: scenario.reward,
)
