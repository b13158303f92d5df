"""Vehicles entering the road."""

import math
from typing import Any

from marl_lanes.traffic.following.curves import entry_speed
from marl_lanes.traffic.following.idm import interaction_term
from marl_lanes.traffic.machine.compiled import internal
from marl_lanes.traffic.machine.random import choice, uniform
from marl_lanes.traffic.machine.state import NONE, Fate
from marl_lanes.traffic.road.geometry import half_extent, lane_centre, occupy, road_turn_rate
from marl_lanes.traffic.road.neighbors import bumper_gap, neighbor_in_lane

_STAYS = int(Fate.STAYS)


@internal
def schedule(road: Any, lane_record: Any, now: float, profiles: Any, constants: Any) -> None:
    """Draw time, initial speed and driver profile of the lane's next departure."""
    wait = uniform(road, constants.interval_low, constants.interval_high)
    lane_record.next_departure = now + wait
    lane_record.next_speed = uniform(
        road, constants.initial_speed_low, constants.initial_speed_high
    )
    lane_record.next_profile = choice(road, profiles["share"])


@internal
def has_room(front: Any, entering: Any, profiles: Any) -> bool:
    """Whether the gap to the vehicle ahead is at least the driver's own desired gap s*."""
    profile = profiles[entering.profile]
    gap = bumper_gap(entering, front, profiles)
    term = interaction_term(
        entering.speed,
        gap,
        entering.speed - front.speed,
        profile.minimum_gap,
        profile.time_headway,
        profile.braking_scale,
    )
    return bool(term <= 1.0 and gap > 0.0)


@internal
def _place(car: Any, lane: int, lane_record: Any, profiles: Any, arcs: Any, constants: Any) -> None:
    """Put a vehicle at the beginning of the lane."""
    car.position = 0.0
    car.lateral_position = lane_centre(lane, constants.lane_width)
    car.speed = lane_record.next_speed
    car.acceleration = 0.0
    car.advance = 0.0
    car.yaw = 0.0
    car.yaw_acceleration = 0.0
    car.profile = lane_record.next_profile
    car.lane = lane
    car.agent = NONE
    car.changer = NONE
    car.moving_over = 0
    car.fate = _STAYS
    if arcs.shape[0] > 0:
        car.speed = entry_speed(car, profiles[car.profile], arcs, constants)
    car.yaw_rate = road_turn_rate(car, arcs)
    occupy(car, half_extent(0.0, profiles[car.profile]), constants)


@internal
def _next_due(
    lanes: Any, last: int, last_time: float, now: float, is_crowded: bool
) -> tuple[int, float]:
    """The lane after ``last`` whose vehicle is due: by time if it is crowded, else by number.

    Returns:
        The lane, and the time that orders it: when its vehicle was due, or 0.
    """
    chosen, least = NONE, math.inf
    for lane in range(lanes.shape[0]):
        due = lanes[lane].next_departure
        if now < due:
            continue
        time = due if is_crowded else 0.0
        is_later = time > last_time or (time == last_time and lane > last)
        if is_later and time < least:
            chosen, least = lane, time
    return chosen, least


@internal
def depart(
    road: Any,
    lanes: Any,
    vehicles: Any,
    order: Any,
    agents: Any,
    constants: Any,
    profiles: Any,
    dispositions: Any,
    arcs: Any,
) -> None:
    """Let the vehicles that are due enter if there is room; the others wait.

    They enter lane by lane from the right; where there are not enough free slots for all, the
    vehicle that has waited longest enters first.
    """
    now = road.step * constants.time_step
    num_due = 0
    for lane in range(lanes.shape[0]):
        if now >= lanes[lane].next_departure:
            num_due += 1
    num_free = vehicles.shape[0] - road.num_vehicles - road.num_removed
    is_crowded = num_due > num_free
    lane, time = NONE, -math.inf
    for untried in range(num_due, 0, -1):
        if num_free == 0:
            road.num_held_back += untried
            return
        lane, time = _next_due(lanes, lane, time, now, is_crowded)
        slot = 0
        while vehicles[slot].id != NONE or vehicles[slot].fate != _STAYS:
            slot += 1
        car = vehicles[slot]
        _place(car, lane, lanes[lane], profiles, arcs, constants)
        count = road.num_vehicles
        front = neighbor_in_lane(count, lane, -1, order, count, vehicles, agents)
        if front != NONE and not has_room(vehicles[front], car, profiles):
            continue
        car.id = road.num_entered
        profile = profiles[car.profile]
        car.desired_speed = uniform(road, profile.desired_speed_low, profile.desired_speed_high)
        car.disposition = choice(road, dispositions)
        car.command_position = uniform(road, constants.command_low, constants.command_high)
        order[count] = slot
        num_free -= 1
        road.num_vehicles += 1
        road.num_entered += 1
        schedule(road, lanes[lane], now, profiles, constants)


@internal
def clear_road(road: Any, lanes: Any, vehicles: Any, profiles: Any, constants: Any) -> None:
    """Empty the road and set it to the beginning of its warm-up; the random numbers continue."""
    for slot in range(vehicles.shape[0]):
        vehicles[slot].id = NONE
        vehicles[slot].agent = NONE
        vehicles[slot].fate = _STAYS
    warmup = uniform(road, constants.warmup_low, constants.warmup_high)
    road.step = -math.ceil(warmup / constants.time_step)
    road.num_vehicles = road.num_entered = road.num_left = road.num_off_road = 0
    road.num_removed = road.num_held_back = 0
    road.num_collided = road.num_collisions = 0
    road.num_moves_over = road.num_moves_returned = 0
    road.num_commands = road.num_live = road.num_ended = road.is_done = road.is_cut = 0
    now = road.step * constants.time_step
    for lane in range(lanes.shape[0]):
        schedule(road, lanes[lane], now, profiles, constants)
        # A road begins at a random time between two departures.
        lanes[lane].next_departure = now + uniform(road, 0.0, constants.interval_high)
