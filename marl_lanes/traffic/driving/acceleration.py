"""Longitudinal acceleration of every vehicle, in one sweep from the front of the road."""

from typing import Any

from marl_lanes.traffic.driving.action import drive_by_action
from marl_lanes.traffic.driving.dispositions import comfortable_in_curves, drive_alone, drive_among
from marl_lanes.traffic.driving.gap_seeking import desired_speed_of, seek_or_hold
from marl_lanes.traffic.following.car_following import follow
from marl_lanes.traffic.following.idm import free_road_term, idm_acceleration
from marl_lanes.traffic.machine.compiled import internal
from marl_lanes.traffic.machine.prefetch import prefetch
from marl_lanes.traffic.machine.state import NONE, Phase
from marl_lanes.traffic.machine.team import any_member, is_team, member, team_size
from marl_lanes.traffic.road.geometry import is_body_in
from marl_lanes.traffic.road.motion import attainable
from marl_lanes.traffic.road.neighbors import body_ahead, entering_ahead, find_rank

_ENGAGED = int(Phase.ENGAGED)

_SPARE_SLOTS = 4
"""Slots that are prefetched in addition to the number of vehicles."""


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
    """Acceleration of the agent's vehicle by car following, in the present state [m/s^2].

    The leaders are the agent's neighbors; the driver's disposition has no effect.
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
        toward = follow(car, front, free_road, limit, headway, scale, profiles, constants)
        acceleration = min(acceleration, toward)
    is_changing = agent.phase == _ENGAGED or is_body_in(car, agent.target_lane)
    if agent.target_leader > NONE and is_changing:
        front = vehicles[agent.target_leader]
        toward = follow(car, front, free_road, limit, headway, scale, profiles, constants)
        acceleration = min(acceleration, max(toward, holding))
    acceleration = min(acceleration, comfortable_in_curves(car, profile, arcs, constants))
    return float(attainable(acceleration, car, constants))


@internal
def _is_alone(car: Any) -> bool:
    """Whether the vehicle only follows the leader in its lane, as most do."""
    is_in_one = car.lane_low == car.lane_high and car.moving_over == 0
    return bool(is_in_one and car.changer == NONE and car.agent == NONE)


@internal
def _accelerate_alone(
    car: Any, front: int, vehicles: Any, profiles: Any, arcs: Any, constants: Any
) -> float:
    """The acceleration of such a vehicle behind the nearest one in its lane [m/s^2]."""
    acceleration = drive_alone(car, front, vehicles, profiles, constants)
    if arcs.shape[0] > 0:
        allowed = comfortable_in_curves(car, profiles[car.profile], arcs, constants)
        acceleration = min(acceleration, allowed)
    return float(max(acceleration, -constants.max_braking))


@internal
def _accelerate_among(
    rank: int,
    car: Any,
    count: int,
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
) -> float:
    """The acceleration of any vehicle, by its disposition, its phase or an action [m/s^2]."""
    acceleration = drive_among(
        rank, car, lanes, vehicles, order, count, agents, profiles, constants
    )
    if arcs.shape[0] > 0:
        allowed = comfortable_in_curves(car, profiles[car.profile], arcs, constants)
        acceleration = min(acceleration, allowed)
    if car.agent > NONE and constants.has_longitudinal:
        agents[car.agent].car_following = attainable(acceleration, car, constants)
        acceleration = drive_by_action(
            rank,
            car,
            actions[car.agent, 1],
            constants.longitudinal_max_acceleration,
            constants.longitudinal_max_braking,
            constants.longitudinal_max_speed,
            True,
            lanes,
            vehicles,
            order,
            agents,
            profiles,
            arcs,
            constants,
        )
    elif car.changer > NONE and constants.num_external > 0:
        index = vehicles[car.changer].agent
        if followers[index].vehicle == order[rank]:
            acceleration = drive_by_action(
                rank,
                car,
                follower_actions[index, 0],
                constants.external_max_acceleration,
                constants.external_max_braking,
                constants.external_max_speed,
                constants.is_external_guarded,
                lanes,
                vehicles,
                order,
                agents,
                profiles,
                arcs,
                constants,
            )
    return float(max(acceleration, -constants.max_braking))


@internal
def _note(slot: int, car: Any, lanes: Any, agents: Any) -> None:
    """Note the vehicle as the last one seen in its lanes."""
    # A body overlaps one or two lanes, or more if it is turned across the road.
    for lane in range(car.lane_low, car.lane_high + 1):
        lanes[lane].nearest = slot
    if car.agent > NONE:
        if agents[car.agent].phase == _ENGAGED:
            lanes[agents[car.agent].target_lane].nearest_engaged = slot
    elif car.moving_over != 0:
        lanes[car.lane].nearest_engaged = slot


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

    It is that of car following, or an agent's second action, or an external follower's action.

    One sweep goes from the front of the road to its rear. Each lane stores the last vehicle seen in
    it: the leader of the next one. In the same loop the vehicles of the road ``after`` are
    prefetched from ``every_vehicle``, (E, V). A team shares the vehicles out, and fills in the
    lanes afterwards.
    """
    size = vehicles.itemsize
    count = road.num_vehicles
    first, stop, stride = member(), count, team_size()
    if is_team() and constants.is_acc:
        # Each vehicle takes the new acceleration of its leader.
        first, stop, stride = 0, count if member() == 0 else 0, 1
    if not is_team():
        for lane in range(lanes.shape[0]):
            lanes[lane].nearest = NONE
            lanes[lane].nearest_engaged = NONE
    has_entering = False
    for rank in range(first, stop, stride):
        prefetch(every_vehicle, after, rank * size, size)
        slot = order[rank]
        car = vehicles[slot]
        if _is_alone(car):
            lane = car.lane_low
            front = body_ahead(rank, lane, lanes, order, vehicles)
            car.acceleration = _accelerate_alone(car, front, vehicles, profiles, arcs, constants)
            if not is_team():
                lanes[lane].nearest = slot
            continue
        car.acceleration = _accelerate_among(
            rank,
            car,
            count,
            lanes,
            vehicles,
            order,
            agents,
            followers,
            actions,
            follower_actions,
            profiles,
            arcs,
            constants,
        )
        if is_team():
            is_engaged = car.agent > NONE and agents[car.agent].phase == _ENGAGED
            has_entering = has_entering or is_engaged or car.moving_over != 0
        else:
            _note(slot, car, lanes, agents)
    if is_team():
        has_entering = any_member(has_entering)
        for lane in range(member(), lanes.shape[0], team_size()):
            lanes[lane].nearest = body_ahead(count, lane, lanes, order, vehicles)
            lanes[lane].nearest_engaged = NONE
            if has_entering:
                last = entering_ahead(count, lane, lanes, order, vehicles, agents)
                lanes[lane].nearest_engaged = last
    # Departures take the first free slot, so vehicles are in the first slots, with a few free.
    prefetch(every_vehicle, after, count * size, _SPARE_SLOTS * size)
