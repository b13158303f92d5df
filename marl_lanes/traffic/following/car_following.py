"""The scenario's car-following law between two vehicles: Eq. 9, the standard IDM, the ACC model.

The ACC model uses the leader's acceleration. In the sweep (``driving/acceleration.py``) it is that
of the same step, because leaders come first. The gap rule and the observation are computed after
the move, and use that of the last step.
"""

from typing import Any

from marl_lanes.traffic.following.idm import (
    acc_acceleration,
    constant_acceleration_heuristic,
    free_road_term,
    idm_acceleration,
    interaction_term,
)
from marl_lanes.traffic.machine.compiled import internal
from marl_lanes.traffic.road.neighbors import bumper_gap


@internal
def follow(
    car: Any,
    front: Any,
    free_road: float,
    limit: float,
    headway: float,
    scale: float,
    profiles: Any,
    constants: Any,
) -> float:
    """Acceleration behind one leader [m/s^2].

    Args:
        car: the following vehicle.
        front: the leader.
        free_road: ``free_road_term`` [1].
        limit: a_m [m/s^2].
        headway: T [s].
        scale: 2 sqrt(a_m b) [m/s^2].
        profiles: the drivers' profiles, for s0, b and the lengths of the bodies.
        constants: the scenario's constants, for the law.
    """
    profile = profiles[car.profile]
    gap = bumper_gap(car, front, profiles)
    closing = car.speed - front.speed
    interaction = interaction_term(car.speed, gap, closing, profile.minimum_gap, headway, scale)
    acceleration = idm_acceleration(limit, free_road, interaction, constants.is_sum_form)
    if constants.is_acc:
        heuristic = constant_acceleration_heuristic(
            car.speed, gap, front.speed, front.acceleration, limit
        )
        braking = profile.comfortable_braking
        acceleration = acc_acceleration(acceleration, heuristic, braking, constants.coolness)
        # Behind an accelerating leader the driver accelerates at most as on a free road.
        acceleration = min(acceleration, limit * (1.0 - free_road))
    return acceleration


@internal
def follow_plainly(car: Any, front: Any, profiles: Any, constants: Any) -> float:
    """``follow`` with the driver's own parameters [m/s^2]."""
    profile = profiles[car.profile]
    return follow(
        car,
        front,
        free_road_term(car.speed, car.desired_speed, profile.exponent),
        profile.max_acceleration,
        profile.time_headway,
        profile.braking_scale,
        profiles,
        constants,
    )
