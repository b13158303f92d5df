"""Longitudinal acceleration of every vehicle: the leaders in its lanes, and its disposition.

cooperative: takes the engaged changer as its leader from engagement on, with a longer headway and
gentle braking while the changer's body is not yet in its lane; or leaves it the lane (yielding.py).
neutral: plain car following; the changer counts once its body overlaps the lane. adversarial: until
the body is in its lane it drives for a higher speed, with more acceleration and a shorter headway,
as if the changer were not there; then it follows the car-following law, as hard as it must brake.
external: while it is paired, its policy's acceleration, within bounds; otherwise neutral.
"""

import math
from typing import Any

from marl_lanes.traffic.compiled import internal
from marl_lanes.traffic.curves import curve_acceleration
from marl_lanes.traffic.idm import free_road_term, idm_acceleration, interaction_term
from marl_lanes.traffic.kinematics import attainable
from marl_lanes.traffic.neighbors import bumper_gap
from marl_lanes.traffic.prefetch import prefetch
from marl_lanes.traffic.state import NONE, Disposition, Phase

_COOPERATIVE = int(Disposition.COOPERATIVE)
_ADVERSARIAL = int(Disposition.ADVERSARIAL)
_WAITING = int(Phase.WAITING)
_ENGAGED = int(Phase.ENGAGED)
_SPARE_SLOTS = 4


@internal
def _interaction(car: Any, front: Any, headway: float, scale: float, s0: float, c: Any) -> float:
    """The interaction term toward ``front``."""
    gap = bumper_gap(car, front, c)
    return interaction_term(car.speed, gap, car.speed - front.speed, s0, headway, scale)


@internal
def drive_alone(car: Any, profile: Any, front: int, vehicles: Any, constants: Any) -> float:
    """Plain car following behind one leader, or none [m/s^2]."""
    interaction = 0.0
    if front > NONE:
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
def is_beside(car: Any, follower: int, vehicles: Any, constants: Any) -> bool:
    """Whether the target lane's follower, not itself commanded, overlaps the car lengthwise."""
    if follower == NONE:
        return False
    other = vehicles[follower]
    # Two that wait for each other's lane would both brake.
    return bool(other.agent == NONE and bumper_gap(other, car, constants) < 0.0)


@internal
def drive_commanded(
    car: Any,
    profile: Any,
    phase: int,
    acceleration: float,
    ahead: float,
    is_giving_way: bool,
    is_sum_form: int,
) -> float:
    """Car following of a vehicle with a live command, its target lane included [m/s^2].

    Toward the target lane a driver follows by its own profile, whatever its disposition makes of
    its own lane.

    Args:
        car: record of the vehicle.
        profile: of its driver.
        phase: of the command.
        acceleration: toward the leaders in the lanes of its body [m/s^2].
        ahead: the largest interaction term toward the leaders in its target lane, 0 without one;
            counts while engaged, and no harder than comfortable while waiting [1].
        is_giving_way: whether it waits beside a vehicle of the target lane and gives way to it.
        is_sum_form: as in ``idm_acceleration``.
    """
    if phase == _WAITING and is_giving_way:
        return float(min(acceleration, -profile.comfortable_braking))
    if ahead == 0.0 or phase not in (_WAITING, _ENGAGED):
        return float(acceleration)
    free_road = free_road_term(car.speed, car.desired_speed, profile.exponent)
    beyond = idm_acceleration(profile.max_acceleration, free_road, ahead, is_sum_form)
    if phase == _WAITING:
        beyond = max(beyond, -profile.comfortable_braking)
    return float(min(acceleration, beyond))


@internal
def car_following(agent: Any, vehicles: Any, profiles: Any, arcs: Any, constants: Any) -> float:
    """What car following would do with the agent's vehicle in the present state [m/s^2].

    Its leaders are the agent's neighbors; the disposition of its driver does not enter.
    """
    car = vehicles[agent.vehicle]
    profile = profiles[car.profile]
    headway, scale, s0 = profile.time_headway, profile.braking_scale, profile.minimum_gap
    interaction, ahead = 0.0, 0.0
    if agent.leader > NONE and car.lane_low <= agent.origin_lane <= car.lane_high:
        interaction = _interaction(car, vehicles[agent.leader], headway, scale, s0, constants)
    if agent.target_leader > NONE:
        ahead = _interaction(car, vehicles[agent.target_leader], headway, scale, s0, constants)
        if car.lane_low <= agent.target_lane <= car.lane_high:
            interaction = max(interaction, ahead)
    free_road = free_road_term(car.speed, car.desired_speed, profile.exponent)
    is_sum_form = constants.is_sum_form
    acceleration = drive_commanded(
        car,
        profile,
        agent.phase,
        idm_acceleration(profile.max_acceleration, free_road, interaction, is_sum_form),
        ahead,
        is_beside(car, agent.target_follower, vehicles, constants),
        is_sum_form,
    )
    acceleration = min(acceleration, comfortable_in_curves(car, profile, arcs, constants))
    return float(attainable(acceleration, car, constants))


@internal
def comfortable_in_curves(car: Any, profile: Any, arcs: Any, constants: Any) -> float:
    """What the curves ahead leave to the driver, inf without one [m/s^2]."""
    lateral, braking = profile.comfortable_lateral_acceleration, profile.comfortable_braking
    return curve_acceleration(car, lateral, braking, arcs, constants)


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
def _bounded(car: Any, wanted: float, limit: float, braking: float, top: float, c: Any) -> float:
    """An action within [-braking, limit], and no faster than ``top`` after the step [m/s^2]."""
    acceleration = min(max(wanted, -braking), limit)
    room = (top - car.speed) / c.time_step
    return float(min(acceleration, max(room, 0.0)))


@internal
def _drive_external(
    car: Any,
    profile: Any,
    wanted: float,
    lanes: Any,
    vehicles: Any,
    agents: Any,
    arcs: Any,
    c: Any,
) -> float:
    """A follower's action, within its bounds, its speed limit and the guard [m/s^2]."""
    limit = c.external_max_acceleration
    braking, top = c.external_max_braking, c.external_max_speed
    acceleration = _bounded(car, wanted, limit, braking, top, c)
    if c.is_external_guarded:
        acceleration = min(
            acceleration, _guard(car, profile, limit, lanes, vehicles, agents, arcs, c)
        )
    return float(acceleration)


@internal
def _drive_by_agent(
    car: Any,
    profile: Any,
    wanted: float,
    lanes: Any,
    vehicles: Any,
    agents: Any,
    arcs: Any,
    c: Any,
) -> float:
    """A changer's second action, within its bounds, its speed limit and the guard [m/s^2]."""
    limit = c.longitudinal_max_acceleration
    braking, top = c.longitudinal_max_braking, c.longitudinal_max_speed
    acceleration = _bounded(car, wanted, limit, braking, top, c)
    return float(min(acceleration, _guard(car, profile, limit, lanes, vehicles, agents, arcs, c)))


@internal
def yield_to(car: Any, profile: Any, changer: Any, constants: Any) -> float:
    """Car following of a cooperative driver behind its changer, with the longer headway [m/s^2]."""
    headway, scale = constants.cooperative_time_headway, profile.braking_scale
    term = _interaction(car, changer, headway, scale, profile.minimum_gap, constants)
    free_road = free_road_term(car.speed, car.desired_speed, profile.exponent)
    return idm_acceleration(profile.max_acceleration, free_road, term, constants.is_sum_form)


@internal
def _lane_ahead(car: Any, profile: Any, lane: Any, vehicles: Any, constants: Any) -> float:
    """The largest interaction term toward who is ahead in the lane, or on the way to it [1]."""
    ahead = 0.0
    headway, scale, s0 = profile.time_headway, profile.braking_scale, profile.minimum_gap
    for front in (lane.nearest, lane.nearest_engaged):
        if front > NONE:
            term = _interaction(car, vehicles[front], headway, scale, s0, constants)
            ahead = max(ahead, term)
    return ahead


@internal
def _drive_among(
    car: Any, profile: Any, lanes: Any, vehicles: Any, agents: Any, constants: Any
) -> float:
    """The smallest acceleration toward the leaders in several lanes, by disposition [m/s^2]."""
    headway, scale = profile.time_headway, profile.braking_scale
    limit, desired_speed = profile.max_acceleration, car.desired_speed
    has_changer = car.changer > NONE
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
        if front > NONE:
            term = _interaction(
                car, vehicles[front], headway, scale, profile.minimum_gap, constants
            )
            interaction = max(interaction, term)
    free_road = free_road_term(car.speed, desired_speed, profile.exponent)
    acceleration = idm_acceleration(limit, free_road, interaction, constants.is_sum_form)
    if car.agent > NONE:
        agent = agents[car.agent]
        ahead = _lane_ahead(car, profile, lanes[agent.target_lane], vehicles, constants)
        is_giving_way = is_beside(car, agent.target_follower, vehicles, constants)
        acceleration = drive_commanded(
            car, profile, agent.phase, acceleration, ahead, is_giving_way, constants.is_sum_form
        )
    elif car.moving_over != 0:
        ahead = _lane_ahead(car, profile, lanes[car.lane], vehicles, constants)
        beyond = idm_acceleration(limit, free_road, ahead, constants.is_sum_form)
        acceleration = min(acceleration, beyond)
        # It leaves the lane to the changer: no need to brake for who is not there yet.
        has_changer = has_changer and agents[vehicles[car.changer].agent].target_lane == car.lane
    if has_changer and car.disposition == _COOPERATIVE:
        yielding = yield_to(car, profile, vehicles[car.changer], constants)
        if not is_body_in:
            yielding = max(yielding, -constants.cooperative_max_braking)
        acceleration = min(acceleration, yielding)
    return acceleration


@internal
def accelerate(
    road: Any,
    lanes: Any,
    vehicles: Any,
    order: Any,
    agents: Any,
    followers: Any,
    actions: Any,
    follower_actions: Any,
    profiles: Any,
    arcs: Any,
    constants: Any,
    every_vehicle: Any,
    after: int,
) -> None:
    """Set every vehicle's acceleration, not below the physical braking limit.

    Car following, unless an agent's second action or an external follower's action stands for it.

    One sweep from the front of the road to its rear, in which each lane remembers the vehicle last
    seen in it: the leader of the next one. Meanwhile the vehicles of the road ``after`` are
    prefetched from ``every_vehicle``, (E, V).
    """
    for lane in range(lanes.shape[0]):
        lanes[lane].nearest = NONE
        lanes[lane].nearest_engaged = NONE
    size = vehicles.itemsize
    for rank in range(road.num_vehicles):
        prefetch(every_vehicle, after, rank * size, size)
        slot = order[rank]
        car = vehicles[slot]
        profile = profiles[car.profile]
        lane = car.lane_low
        is_alone = lane == car.lane_high and car.changer == NONE and car.agent == NONE
        if is_alone and car.moving_over == 0:
            # Most vehicles: nothing else can hold for them.
            acceleration = drive_alone(car, profile, lanes[lane].nearest, vehicles, constants)
            if arcs.shape[0] > 0:
                allowed = comfortable_in_curves(car, profile, arcs, constants)
                acceleration = min(acceleration, allowed)
            car.acceleration = max(acceleration, -constants.max_braking)
            lanes[lane].nearest = slot
            continue
        acceleration = _drive_among(car, profile, lanes, vehicles, agents, constants)
        if arcs.shape[0] > 0:
            allowed = comfortable_in_curves(car, profile, arcs, constants)
            acceleration = min(acceleration, allowed)
        if car.agent > NONE and constants.has_longitudinal:
            agents[car.agent].car_following = attainable(acceleration, car, constants)
            wanted = actions[car.agent, 1]
            acceleration = _drive_by_agent(
                car, profile, wanted, lanes, vehicles, agents, arcs, constants
            )
        elif car.changer > NONE and constants.num_external > 0:
            index = vehicles[car.changer].agent
            if followers[index].vehicle == slot:
                wanted = follower_actions[index, 0]
                acceleration = _drive_external(
                    car, profile, wanted, lanes, vehicles, agents, arcs, constants
                )
        car.acceleration = max(acceleration, -constants.max_braking)
        # A body is narrower than a lane, but it can lie across the road.
        for lane in range(car.lane_low, car.lane_high + 1):
            lanes[lane].nearest = slot
        if car.agent > NONE:
            if agents[car.agent].phase == _ENGAGED:
                lanes[agents[car.agent].target_lane].nearest_engaged = slot
        elif car.moving_over != 0:
            lanes[car.lane].nearest_engaged = slot
    # Departures take the first free slot: vehicles are in the first slots, with gaps.
    prefetch(every_vehicle, after, road.num_vehicles * size, _SPARE_SLOTS * size)
