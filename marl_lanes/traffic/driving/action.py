"""Acceleration by an action: a changer's second action, or an external follower's."""

import math
from typing import Any

from marl_lanes.traffic.following.curves import curve_acceleration
from marl_lanes.traffic.following.idm import interaction_term
from marl_lanes.traffic.machine.compiled import internal
from marl_lanes.traffic.machine.state import NONE, Phase
from marl_lanes.traffic.road.neighbors import body_ahead, bumper_gap, entering_ahead

_ENGAGED = int(Phase.ENGAGED)


@internal
def _interaction(
    car: Any, front: Any, headway: float, scale: float, s0: float, profiles: Any
) -> float:
    """The interaction term toward ``front``."""
    gap = bumper_gap(car, front, profiles)
    return interaction_term(car.speed, gap, car.speed - front.speed, s0, headway, scale)


@internal
def _guard(
    rank: int,
    car: Any,
    limit: float,
    lanes: Any,
    vehicles: Any,
    order: Any,
    agents: Any,
    profiles: Any,
    arcs: Any,
    constants: Any,
) -> float:
    """a_max (1 - (s*/s)^2), with a_max = ``limit``, and the gap rule's d_min, tau, b_max [m/s^2].

    d_min, tau and b_max replace s0, T and b. The smallest value over the bodies ahead in the car's
    lanes and, for an engaged changer, in its target lane; at most the acceleration toward the
    speed in curves, with braking b_max ahead of them.
    """
    scale = 2.0 * math.sqrt(limit * constants.gap_max_braking)
    headway, s0 = constants.gap_time, constants.gap_minimum
    interaction = 0.0
    for lane in range(car.lane_low, car.lane_high + 1):
        front = body_ahead(rank, lane, lanes, order, vehicles)
        if front > NONE:
            term = _interaction(car, vehicles[front], headway, scale, s0, profiles)
            interaction = max(interaction, term)
    if car.agent > NONE and agents[car.agent].phase == _ENGAGED:
        target = agents[car.agent].target_lane
        body = body_ahead(rank, target, lanes, order, vehicles)
        entering = entering_ahead(rank, target, lanes, order, vehicles, agents)
        for front in (body, entering):
            if front > NONE:
                term = _interaction(car, vehicles[front], headway, scale, s0, profiles)
                interaction = max(interaction, term)
    lateral = profiles[car.profile].comfortable_lateral_acceleration
    braking = constants.gap_max_braking
    allowed = curve_acceleration(car, lateral, braking, arcs, constants)
    return float(min(limit * (1.0 - interaction), allowed))


@internal
def drive_by_action(
    rank: int,
    car: Any,
    action: float,
    max_acceleration: float,
    max_braking: float,
    max_speed: float,
    is_guarded: bool,
    lanes: Any,
    vehicles: Any,
    order: Any,
    agents: Any,
    profiles: Any,
    arcs: Any,
    constants: Any,
) -> float:
    """The action, clipped to [-max_braking, max_acceleration] and by the guard [m/s^2].

    It does not accelerate the car beyond ``max_speed``.
    """
    acceleration = min(max(action, -max_braking), max_acceleration)
    room = (max_speed - car.speed) / constants.time_step
    acceleration = min(acceleration, max(room, 0.0))
    if is_guarded:
        limit = _guard(
            rank,
            car,
            max_acceleration,
            lanes,
            vehicles,
            order,
            agents,
            profiles,
            arcs,
            constants,
        )
        acceleration = min(acceleration, limit)
    return float(acceleration)
