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

from marl_lanes.traffic.car_following import follow, follow_plainly
from marl_lanes.traffic.compiled import internal
from marl_lanes.traffic.curves import curve_acceleration
from marl_lanes.traffic.gap_seeking import desired_speed_of, seek_or_hold
from marl_lanes.traffic.idm import free_road_term, idm_acceleration, interaction_term
from marl_lanes.traffic.kinematics import attainable
from marl_lanes.traffic.neighbors import bumper_gap, find_rank, is_body_in
from marl_lanes.traffic.prefetch import prefetch
from marl_lanes.traffic.state import NONE, Disposition, Phase

_COOPERATIVE = int(Disposition.COOPERATIVE)
_ADVERSARIAL = int(Disposition.ADVERSARIAL)
_ABSENT = int(Phase.ABSENT)
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
    if front > NONE:
        return follow_plainly(car, vehicles[front], profile, constants)
    free_road = free_road_term(car.speed, car.desired_speed, profile.exponent)
    return idm_acceleration(profile.max_acceleration, free_road, 0.0, constants.is_sum_form)


@internal
def car_following(
    agent: Any,
    order: Any,
    count: int,
    vehicles: Any,
    agents: Any,
    profiles: Any,
    arcs: Any,
    constants: Any,
) -> float:
    """What car following would do with the agent's vehicle in the present state [m/s^2].

    Its leaders are the agent's neighbors; the disposition of its driver does not enter.
    """
    car = vehicles[agent.vehicle]
    profile = profiles[car.profile]
    limit, headway, scale = profile.max_acceleration, profile.time_headway, profile.braking_scale
    rank = find_rank(agent.vehicle, order)
    seeking, holding = seek_or_hold(
        rank, car, agent, order, count, vehicles, agents, profiles, constants
    )
    desired_speed = desired_speed_of(car, agent, seeking, constants)
    free_road = free_road_term(car.speed, desired_speed, profile.exponent)
    acceleration = min(idm_acceleration(limit, free_road, 0.0, constants.is_sum_form), seeking)
    if agent.leader > NONE and is_body_in(car, agent.origin_lane):
        front = vehicles[agent.leader]
        toward = follow(car, front, free_road, limit, headway, scale, profile, constants)
        acceleration = min(acceleration, toward)
    is_changing = agent.phase == _ENGAGED or is_body_in(car, agent.target_lane)
    if agent.target_leader > NONE and is_changing:
        front = vehicles[agent.target_leader]
        toward = follow(car, front, free_road, limit, headway, scale, profile, constants)
        acceleration = min(acceleration, max(toward, holding))
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
    free_road = free_road_term(car.speed, car.desired_speed, profile.exponent)
    limit = profile.max_acceleration
    return follow(car, changer, free_road, limit, headway, scale, profile, constants)


@internal
def _toward_lane(
    car: Any, profile: Any, desired_speed: float, lane: Any, vehicles: Any, constants: Any
) -> float:
    """The smallest acceleration toward who is ahead in the lane, or on the way to it [m/s^2].

    By the driver's own profile, whatever its disposition makes of its own lane; inf without one.
    """
    headway, scale = profile.time_headway, profile.braking_scale
    free_road = free_road_term(car.speed, desired_speed, profile.exponent)
    limit, acceleration = profile.max_acceleration, math.inf
    for front in (lane.nearest, lane.nearest_engaged):
        if front > NONE:
            toward = follow(
                car, vehicles[front], free_road, limit, headway, scale, profile, constants
            )
            acceleration = min(acceleration, toward)
    return acceleration


@internal
def _drive_among(
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
    """The smallest acceleration toward the leaders in several lanes, by disposition [m/s^2]."""
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
        front = lanes[lane].nearest
        if front > NONE:
            toward = follow(
                car, vehicles[front], free_road, limit, headway, scale, profile, constants
            )
            acceleration = min(acceleration, toward)
    if phase == _ENGAGED:
        lane = agents[car.agent].target_lane
        beyond = _toward_lane(car, profile, own_speed, lanes[lane], vehicles, constants)
        acceleration = min(acceleration, max(beyond, holding))
    elif car.moving_over != 0:
        beyond = _toward_lane(car, profile, own_speed, lanes[car.lane], vehicles, constants)
        acceleration = min(acceleration, beyond)
        # It leaves the lane to the changer: no need to brake for who is not there yet.
        has_changer = has_changer and agents[vehicles[car.changer].agent].target_lane == car.lane
    if has_changer and car.disposition == _COOPERATIVE:
        yielding = yield_to(car, profile, vehicles[car.changer], constants)
        if not has_entered:
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
        acceleration = _drive_among(
            rank, car, lanes, vehicles, order, road.num_vehicles, agents, profiles, constants
        )
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
