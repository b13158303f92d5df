"""Driving by an action: a changer's second one, or an external follower's."""

import math
from typing import Any

from marl_lanes.traffic.following.curves import curve_acceleration
from marl_lanes.traffic.following.idm import interaction_term
from marl_lanes.traffic.machine.compiled import internal
from marl_lanes.traffic.machine.state import NONE, Phase
from marl_lanes.traffic.road.neighbors import bumper_gap

_ENGAGED = int(Phase.ENGAGED)


@internal
def _interaction(car: Any, front: Any, headway: float, scale: float, s0: float, c: Any) -> float:
    """The interaction term toward ``front``."""
    gap = bumper_gap(car, front, c)
    return interaction_term(car.speed, gap, car.speed - front.speed, s0, headway, scale)


@internal
def _guard(
    car: Any,
    profile: Any,
    limit: float,
    lanes: Any,
    vehicles: Any,
    agents: Any,
    arcs: Any,
    constants: Any,
) -> float:
    """A limit (1 - (s*/s)^2) with the gap rule's d_min, tau and b_max for s0, T and b [m/s^2].

    Toward the bodies ahead in the car's lanes and, of an engaged changer, in its target lane; not
    more than what keeps a curve's speed with braking b_max ahead of it.
    """
    scale = 2.0 * math.sqrt(limit * constants.gap_max_braking)
    headway, s0 = constants.gap_time, constants.gap_minimum
    interaction = 0.0
    for lane in range(car.lane_low, car.lane_high + 1):
        front = lanes[lane].nearest
        if front > NONE:
            term = _interaction(car, vehicles[front], headway, scale, s0, constants)
            interaction = max(interaction, term)
    if car.agent > NONE and agents[car.agent].phase == _ENGAGED:
        target = lanes[agents[car.agent].target_lane]
        for front in (target.nearest, target.nearest_engaged):
            if front > NONE:
                term = _interaction(car, vehicles[front], headway, scale, s0, constants)
                interaction = max(interaction, term)
    lateral, braking = profile.comfortable_lateral_acceleration, constants.gap_max_braking
    allowed = curve_acceleration(car, lateral, braking, arcs, constants)
    return float(min(limit * (1.0 - interaction), allowed))


@internal
def drive_by_action(
    car: Any,
    profile: Any,
    action: float,
    max_acceleration: float,
    max_braking: float,
    max_speed: float,
    is_guarded: bool,
    lanes: Any,
    vehicles: Any,
    agents: Any,
    arcs: Any,
    constants: Any,
) -> float:
    """The action within [-max_braking, max_acceleration], below the guard's limit [m/s^2].

    It makes the car no faster than ``max_speed``.
    """
    acceleration = min(max(action, -max_braking), max_acceleration)
    room = (max_speed - car.speed) / constants.time_step
    acceleration = min(acceleration, max(room, 0.0))
    if is_guarded:
        limit = _guard(car, profile, max_acceleration, lanes, vehicles, agents, arcs, constants)
        acceleration = min(acceleration, limit)
    return float(acceleration)
