"""The follower: an external driver behind a changer, in the changer's target lane.

A feature's formula has the changer's record, the driver's vehicle, the changer's vehicle and the
``Scene`` as arguments, a reward term's formula its weight and the ``Step``.
"""

import math
from typing import Any, NamedTuple

from marl_lanes.scenario import Scenario
from marl_lanes.traffic.command.phases import lateral_deviation
from marl_lanes.traffic.machine.compiled import internal
from marl_lanes.traffic.machine.state import FOLLOWER as RECORD
from marl_lanes.traffic.machine.state import NONE, Fate
from marl_lanes.traffic.road.geometry import is_body_in
from marl_lanes.traffic.road.neighbors import bumper_gap
from marl_lanes.traffic.roles.role import (
    Dimension,
    Feature,
    Role,
    Term,
    make_observer,
    make_payment,
)

_COLLIDES = int(Fate.COLLIDES)


@internal
def _leader_gap(agent: Any, driver: Any, scene: Any) -> float:
    if agent.target_leader == NONE:
        return float(scene.constants.sensor_range)
    gap = bumper_gap(driver, scene.vehicles[agent.target_leader], scene.profiles)
    return float(min(gap, scene.constants.sensor_range))


@internal
def _leader_relative_speed(agent: Any, driver: Any, scene: Any) -> float:
    if agent.target_leader == NONE:
        return 0.0
    return float(scene.vehicles[agent.target_leader].speed - driver.speed)


# A star puts the numbers of a row on one line.
FEATURES = (
    Feature(
        *("speed", "m/s", 20.0, 10.0, 0.0, 150.0),
        "own, along the heading",
        lambda agent, driver, changer, scene: driver.speed,
    ),
    Feature(
        *("acceleration", "m/s^2", 0.0, 2.0, -20.0, 20.0),
        "own, of the last step",
        lambda agent, driver, changer, scene: driver.acceleration,
    ),
    Feature(
        *("gap", "m", 20.0, 20.0, -20.0, 1e4),
        "to the changer",
        lambda agent, driver, changer, scene: min(
            bumper_gap(driver, changer, scene.profiles), scene.constants.sensor_range
        ),
    ),
    Feature(
        *("relative_speed", "m/s", 0.0, 5.0, -150.0, 150.0),
        "the changer's speed minus the own",
        lambda agent, driver, changer, scene: changer.speed - driver.speed,
    ),
    Feature(
        *("changer_lateral_deviation", "m", 0.0, 2.0, -100.0, 100.0),
        "of the changer",
        lambda agent, driver, changer, scene: lateral_deviation(agent, changer, scene.constants),
    ),
    Feature(
        *("changer_lateral_speed", "m/s", 0.0, 0.5, -150.0, 150.0),
        "toward the target lane",
        lambda agent, driver, changer, scene: (
            agent.direction * changer.speed * math.sin(changer.yaw)
        ),
    ),
    Feature(
        *("leader_gap", "m", 50.0, 50.0, -20.0, 1e4),
        "to the vehicle ahead in the own lane",
        lambda agent, driver, changer, scene: _leader_gap(agent, driver, scene),
    ),
    Feature(
        *("leader_relative_speed", "m/s", 0.0, 5.0, -150.0, 150.0),
        "its speed minus the own",
        lambda agent, driver, changer, scene: _leader_relative_speed(agent, driver, scene),
    ),
    Feature(
        *("phase", "1", 2.0, 1.0, 0.0, 3.0),
        "the changer's: 1 waiting, 2 engaged, 3 aborting",
        lambda agent, driver, changer, scene: agent.phase,
    ),
)
"""The columns of a follower's observation, in order. The vehicle ahead in the own lane is the
changer's target leader; without one, gap and relative speed are as for a changer."""


class Step(NamedTuple):
    """The result of a paired driver's step, as one argument of the terms' formulas."""

    driver: Any
    agent: Any
    """The changer's record."""
    changer: Any
    has_aborted: bool
    """Whether the changer began to abort in the step."""
    constants: Any


def _charge_discomfort(weight: float, step: Any) -> float:
    acceleration = step.driver.acceleration
    # Not ``** 2``: where nothing is compiled, the C library's power may round differently.
    return float(-weight * (acceleration * acceleration))


TERMS = (
    Term(
        *("delay", "delay_weight", "1/s"),
        "w dt while the changer's body is not in its target lane",
        lambda w, step: (
            0.0
            if is_body_in(step.changer, step.agent.target_lane)
            else w * step.constants.time_step
        ),
    ),
    Term(
        *("abort", "abort_weight", "1"),
        "w in the step in which the changer begins to abort",
        lambda w, step: w if step.has_aborted else 0.0,
    ),
    Term(
        *("collision", "collision_penalty", "1"),
        "-w in the step in which the driver collides",
        lambda w, step: -w if step.driver.fate == _COLLIDES else 0.0,
    ),
    Term(
        *("discomfort", "discomfort_weight", "s^4/m^2"),
        "-w a^2",
        _charge_discomfort,
    ),
    Term(
        *("braking", "braking_weight", "s^2/m"),
        "-w (-a - hard_braking), where that is positive",
        lambda w, step: (
            -w * max(0.0, -step.driver.acceleration - step.constants.follower_hard_braking)
        ),
    ),
)
"""The terms of a paired driver's reward."""

observe_follower = make_observer(FEATURES)
pay_follower = make_payment(TERMS)


def _act(scenario: Scenario) -> tuple[Dimension, ...]:
    external = scenario.followers.external
    low, high = -external.max_braking, external.max_acceleration
    return (Dimension("acceleration", "m/s^2", low, high),)


FOLLOWER = Role(
    name="follower",
    group="followers",
    table="followers",
    record=RECORD,
    observations="follower_observations",
    features=FEATURES,
    terms=TERMS,
    see=lambda _: [feature.name for feature in FEATURES],
    beside=lambda _: (),
    stack=lambda _: 1,
    act=_act,
    reward=lambda scenario: scenario.followers.learned.reward,
)
