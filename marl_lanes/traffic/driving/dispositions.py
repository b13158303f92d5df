"""Car following by disposition: the leaders of a driver, and its reaction to a changer.

cooperative: also follows the engaged changer, with a longer time headway; it brakes only gently for
it until the changer's body is in its lane. Or it moves over (yielding.py).
neutral: plain car following; the changer is a leader once its body overlaps the lane.
adversarial: until the changer's body is in its lane, it ignores the changer, and has a higher
desired speed, more acceleration and a shorter time headway. Then plain car following, which may
brake hard.
external: while it is paired, the acceleration of its policy, within bounds (action.py); otherwise
like neutral.
"""

import math
from typing import Any

from marl_lanes.traffic.driving.gap_seeking import desired_speed_of, seek_or_hold
from marl_lanes.traffic.following.car_following import follow, follow_plainly
from marl_lanes.traffic.following.curves import curve_acceleration
from marl_lanes.traffic.following.idm import free_road_term, idm_acceleration
from marl_lanes.traffic.machine.compiled import internal
from marl_lanes.traffic.machine.state import NONE, Disposition, Phase
from marl_lanes.traffic.road.geometry import is_body_in
from marl_lanes.traffic.road.neighbors import body_ahead, entering_ahead

_COOPERATIVE = int(Disposition.COOPERATIVE)
_ADVERSARIAL = int(Disposition.ADVERSARIAL)
_ABSENT = int(Phase.ABSENT)
_ENGAGED = int(Phase.ENGAGED)


@internal
def drive_alone(car: Any, front: int, vehicles: Any, profiles: Any, constants: Any) -> float:
    """Plain car following behind one leader, or without a leader [m/s^2]."""
    if front > NONE:
        return follow_plainly(car, vehicles[front], profiles, constants)
    profile = profiles[car.profile]
    free_road = free_road_term(car.speed, car.desired_speed, profile.exponent)
    return idm_acceleration(profile.max_acceleration, free_road, 0.0, constants.is_sum_form)


@internal
def comfortable_in_curves(car: Any, profile: Any, arcs: Any, constants: Any) -> float:
    """The largest comfortable acceleration because of curves; inf without curves [m/s^2]."""
    lateral, braking = profile.comfortable_lateral_acceleration, profile.comfortable_braking
    return curve_acceleration(car, lateral, braking, arcs, constants)


@internal
def yield_to(car: Any, changer: Any, profiles: Any, constants: Any) -> float:
    """Car following of a cooperative driver behind its changer, with longer headway [m/s^2]."""
    profile = profiles[car.profile]
    headway, scale = constants.cooperative_time_headway, profile.braking_scale
    free_road = free_road_term(car.speed, car.desired_speed, profile.exponent)
    limit = profile.max_acceleration
    return follow(car, changer, free_road, limit, headway, scale, profiles, constants)


@internal
def _toward_lane(
    rank: int,
    car: Any,
    desired_speed: float,
    lane: int,
    lanes: Any,
    vehicles: Any,
    order: Any,
    agents: Any,
    profiles: Any,
    constants: Any,
) -> float:
    """The smallest acceleration toward the leaders in the lane and moving to it [m/s^2].

    With the parameters of the driver's profile, for every disposition; inf without a leader.
    """
    profile = profiles[car.profile]
    headway, scale = profile.time_headway, profile.braking_scale
    free_road = free_road_term(car.speed, desired_speed, profile.exponent)
    limit, acceleration = profile.max_acceleration, math.inf
    body = body_ahead(rank, lane, lanes, order, vehicles)
    entering = entering_ahead(rank, lane, lanes, order, vehicles, agents)
    for front in (body, entering):
        if front > NONE:
            toward = follow(
                car, vehicles[front], free_road, limit, headway, scale, profiles, constants
            )
            acceleration = min(acceleration, toward)
    return acceleration


@internal
def drive_among(
    rank: int,
    car: Any,
    lanes: Any,
    vehicles: Any,
    order: Any,
    count: int,
    agents: Any,
    profiles: Any,
    constants: Any,
) -> float:
    """The smallest acceleration toward the leaders in all lanes, by disposition [m/s^2]."""
    profile = profiles[car.profile]
    headway, scale = profile.time_headway, profile.braking_scale
    limit, desired_speed = profile.max_acceleration, car.desired_speed
    has_changer = car.changer > NONE
    has_entered = False
    if has_changer:
        changer = vehicles[car.changer]
        has_entered = is_body_in(changer, agents[changer.agent].target_lane)
    phase = _ABSENT
    seeking, holding = math.inf, -math.inf
    if car.agent > NONE:
        agent = agents[car.agent]
        phase = agent.phase
        seeking, holding = seek_or_hold(
            rank, car, agent, order, count, vehicles, agents, profiles, constants
        )
        desired_speed = desired_speed_of(car, agent, seeking, constants)
    own_speed = desired_speed
    if has_changer and not has_entered and car.disposition == _ADVERSARIAL:
        headway, scale = constants.adversarial_time_headway, profile.adversarial_braking_scale
        limit = constants.adversarial_max_acceleration
        desired_speed = desired_speed * constants.adversarial_speed_factor

    free_road = free_road_term(car.speed, desired_speed, profile.exponent)
    acceleration = min(idm_acceleration(limit, free_road, 0.0, constants.is_sum_form), seeking)
    for lane in range(car.lane_low, car.lane_high + 1):
        front = body_ahead(rank, lane, lanes, order, vehicles)
        if front > NONE:
            toward = follow(
                car, vehicles[front], free_road, limit, headway, scale, profiles, constants
            )
            acceleration = min(acceleration, toward)
    if phase == _ENGAGED:
        lane = agents[car.agent].target_lane
        beyond = _toward_lane(
            rank, car, own_speed, lane, lanes, vehicles, order, agents, profiles, constants
        )
        acceleration = min(acceleration, max(beyond, holding))
    elif car.moving_over != 0:
        beyond = _toward_lane(
            rank, car, own_speed, car.lane, lanes, vehicles, order, agents, profiles, constants
        )
        acceleration = min(acceleration, beyond)
        # It makes room for a changer to its old lane, so it no longer brakes for that one.
        has_changer = has_changer and agents[vehicles[car.changer].agent].target_lane == car.lane
    if has_changer and car.disposition == _COOPERATIVE:
        yielding = yield_to(car, vehicles[car.changer], profiles, constants)
        if not has_entered:
            yielding = max(yielding, -constants.cooperative_max_braking)
        acceleration = min(acceleration, yielding)
    return acceleration
