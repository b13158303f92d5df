"""Longitudinal acceleration of every vehicle: the leaders in its lanes, and its disposition.

cooperative: takes the engaged changer as its leader from engagement on, with a longer headway and
gentle braking while the changer's body is not yet in its lane. neutral: plain car following; the
changer counts once its body overlaps the lane. adversarial: until the body is in its lane it drives
for a higher speed, with more acceleration and a shorter headway, as if the changer were not there;
then it follows the car-following law, as hard as it must brake.
"""

from typing import Any

from marl_lanes.traffic.compiled import internal
from marl_lanes.traffic.idm import free_road_term, idm_acceleration, interaction_term
from marl_lanes.traffic.neighbors import bumper_gap
from marl_lanes.traffic.state import NONE, Disposition, Phase

_COOPERATIVE = int(Disposition.COOPERATIVE)
_ADVERSARIAL = int(Disposition.ADVERSARIAL)
_ABSENT = int(Phase.ABSENT)
_WAITING = int(Phase.WAITING)
_ENGAGED = int(Phase.ENGAGED)


@internal
def _interaction(car: Any, front: Any, headway: float, scale: float, s0: float, c: Any) -> float:
    """The interaction term toward ``front``."""
    gap = bumper_gap(car, front, c)
    return interaction_term(car.speed, gap, car.speed - front.speed, s0, headway, scale)


@internal
def _drive_alone(car: Any, profile: Any, front: int, vehicles: Any, constants: Any) -> float:
    """Plain car following behind one leader, or none [m/s^2]."""
    interaction = 0.0
    if front != NONE:
        interaction = _interaction(
            car,
            vehicles[front],
            profile.time_headway,
            profile.braking_scale,
            profile.minimum_gap,
            constants,
        )
    free_road = free_road_term(car.speed, car.desired_speed, profile.exponent)
    return idm_acceleration(profile.max_acceleration, free_road, interaction, constants.is_sum_form)


@internal
def _is_beside(car: Any, follower: int, vehicles: Any, constants: Any) -> bool:
    """Whether the target lane's follower, not itself commanded, overlaps the car lengthwise."""
    if follower == NONE:
        return False
    other = vehicles[follower]
    # Two that wait for each other's lane would both brake.
    return bool(other.agent == NONE and bumper_gap(other, car, constants) < 0.0)


@internal
def _drive_among(
    car: Any, profile: Any, lanes: Any, vehicles: Any, agents: Any, constants: Any
) -> float:
    """The smallest acceleration toward the leaders in several lanes, by disposition [m/s^2]."""
    headway, scale = profile.time_headway, profile.braking_scale
    limit, desired_speed = profile.max_acceleration, car.desired_speed
    has_changer = car.changer != NONE
    is_body_in = False
    if has_changer:
        changer = vehicles[car.changer]
        lane = agents[changer.agent].target_lane
        is_body_in = changer.lane_low <= lane <= changer.lane_high
    if has_changer and not is_body_in and car.disposition == _ADVERSARIAL:
        headway, scale = constants.adversarial_time_headway, profile.adversarial_braking_scale
        limit = constants.adversarial_max_acceleration
        desired_speed = desired_speed * constants.adversarial_speed_factor

    interaction = 0.0
    for lane in range(car.lane_low, car.lane_high + 1):
        front = lanes[lane].nearest
        if front != NONE:
            term = _interaction(
                car, vehicles[front], headway, scale, profile.minimum_gap, constants
            )
            interaction = max(interaction, term)
    ahead = 0.0
    phase = _ABSENT if car.agent == NONE else agents[car.agent].phase
    if phase in (_WAITING, _ENGAGED):
        target = lanes[agents[car.agent].target_lane]
        for front in (target.nearest, target.nearest_engaged):
            if front != NONE:
                term = _interaction(
                    car, vehicles[front], headway, scale, profile.minimum_gap, constants
                )
                ahead = max(ahead, term)
    if phase == _ENGAGED:
        interaction = max(interaction, ahead)
    free_road = free_road_term(car.speed, desired_speed, profile.exponent)
    acceleration = idm_acceleration(limit, free_road, interaction, constants.is_sum_form)

    if phase == _WAITING:
        aligning = idm_acceleration(limit, free_road, ahead, constants.is_sum_form)
        if _is_beside(car, agents[car.agent].target_follower, vehicles, constants):
            aligning = -profile.comfortable_braking
        acceleration = min(acceleration, max(aligning, -profile.comfortable_braking))
    if has_changer and car.disposition == _COOPERATIVE:
        headway = constants.cooperative_time_headway
        term = _interaction(
            car, vehicles[car.changer], headway, scale, profile.minimum_gap, constants
        )
        yielding = idm_acceleration(limit, free_road, term, constants.is_sum_form)
        if not is_body_in:
            yielding = max(yielding, -constants.cooperative_max_braking)
        acceleration = min(acceleration, yielding)
    return acceleration


@internal
def accelerate(
    road: Any, lanes: Any, vehicles: Any, order: Any, agents: Any, profiles: Any, constants: Any
) -> None:
    """Set every vehicle's acceleration, not below the physical braking limit.

    One sweep from the front of the road to its rear, in which each lane remembers the vehicle last
    seen in it: the leader of the next one.
    """
    for lane in range(lanes.shape[0]):
        lanes[lane].nearest = NONE
        lanes[lane].nearest_engaged = NONE
    for rank in range(road.num_vehicles):
        slot = order[rank]
        car = vehicles[slot]
        profile = profiles[car.profile]
        if car.lane_low == car.lane_high and car.changer == NONE and car.agent == NONE:
            front = lanes[car.lane_low].nearest
            acceleration = _drive_alone(car, profile, front, vehicles, constants)
        else:
            acceleration = _drive_among(car, profile, lanes, vehicles, agents, constants)
        car.acceleration = max(acceleration, -constants.max_braking)
        for lane in range(car.lane_low, car.lane_high + 1):
            lanes[lane].nearest = slot
        if car.agent != NONE and agents[car.agent].phase == _ENGAGED:
            lanes[agents[car.agent].target_lane].nearest_engaged = slot
