"""Longitudinal acceleration of every vehicle: the leaders in its lanes, and its disposition.

cooperative: takes the engaged changer as its leader from engagement on, with a longer headway and
gentle braking while the changer's body is not yet in its lane. neutral: plain car following; the
changer counts once its body overlaps the lane. adversarial: until the body is in its lane it drives
for a higher speed, with more acceleration and a shorter headway, as if the changer were not there;
then it follows the car-following law, as hard as it must brake. external: while it is paired, its
policy's acceleration, within bounds; otherwise neutral.
"""

import math
from typing import Any

from marl_lanes.traffic.compiled import internal
from marl_lanes.traffic.curves import curve_acceleration
from marl_lanes.traffic.idm import free_road_term, idm_acceleration, interaction_term
from marl_lanes.traffic.neighbors import bumper_gap
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
def _drive_alone(car: Any, profile: Any, front: int, vehicles: Any, constants: Any) -> float:
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
    profile: Any,
    phase: int,
    limit: float,
    free_road: float,
    interaction: float,
    ahead: float,
    is_giving_way: bool,
    is_sum_form: int,
) -> float:
    """Car following of a vehicle with a live command, or of one without [m/s^2].

    Args:
        profile: of the driver.
        phase: of the command.
        limit: a_m [m/s^2].
        free_road: the free-road term [1].
        interaction: the largest interaction term toward the leaders in the lanes of its body [1].
        ahead: the same toward the leaders in its target lane; counts while engaged, and no harder
            than comfortable while waiting [1].
        is_giving_way: whether it waits beside a vehicle of the target lane and gives way to it.
        is_sum_form: as in ``idm_acceleration``.
    """
    if phase == _ENGAGED:
        interaction = max(interaction, ahead)
    acceleration = idm_acceleration(limit, free_road, interaction, is_sum_form)
    if phase == _WAITING:
        aligning = idm_acceleration(limit, free_road, ahead, is_sum_form)
        if is_giving_way:
            aligning = -profile.comfortable_braking
        acceleration = min(acceleration, max(aligning, -profile.comfortable_braking))
    return acceleration


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
    acceleration = drive_commanded(
        profile,
        agent.phase,
        profile.max_acceleration,
        free_road_term(car.speed, car.desired_speed, profile.exponent),
        interaction,
        ahead,
        is_beside(car, agent.target_follower, vehicles, constants),
        constants.is_sum_form,
    )
    acceleration = min(acceleration, _comfortable(car, profile, arcs, constants))
    return float(max(acceleration, -constants.max_braking))


@internal
def _comfortable(car: Any, profile: Any, arcs: Any, constants: Any) -> float:
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
    ahead = 0.0
    is_giving_way = False
    phase = _ABSENT if car.agent == NONE else agents[car.agent].phase
    if phase in (_WAITING, _ENGAGED):
        target = lanes[agents[car.agent].target_lane]
        for front in (target.nearest, target.nearest_engaged):
            if front > NONE:
                term = _interaction(
                    car, vehicles[front], headway, scale, profile.minimum_gap, constants
                )
                ahead = max(ahead, term)
        is_giving_way = is_beside(car, agents[car.agent].target_follower, vehicles, constants)
    free_road = free_road_term(car.speed, desired_speed, profile.exponent)
    acceleration = drive_commanded(
        profile, phase, limit, free_road, interaction, ahead, is_giving_way, constants.is_sum_form
    )
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
        if car.lane_low == car.lane_high and car.changer == NONE and car.agent == NONE:
            front = lanes[car.lane_low].nearest
            acceleration = _drive_alone(car, profile, front, vehicles, constants)
        else:
            acceleration = _drive_among(car, profile, lanes, vehicles, agents, constants)
        if arcs.shape[0] > 0:
            acceleration = min(acceleration, _comfortable(car, profile, arcs, constants))
        if car.agent > NONE and constants.has_longitudinal:
            agents[car.agent].car_following = max(acceleration, -constants.max_braking)
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
        lanes[car.lane_low].nearest = slot
        if car.lane_high != car.lane_low:
            # A body is narrower than a lane, but it can lie across the road.
            for lane in range(car.lane_low + 1, car.lane_high + 1):
                lanes[lane].nearest = slot
        if car.agent > NONE and agents[car.agent].phase == _ENGAGED:
            lanes[agents[car.agent].target_lane].nearest_engaged = slot
    # Departures take the first free slot: vehicles are in the first slots, with gaps.
    prefetch(every_vehicle, after, road.num_vehicles * size, _SPARE_SLOTS * size)
