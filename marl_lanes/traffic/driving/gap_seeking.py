"""A waiting driver seeks a gap in the target lane: which one, and how it gets there.

A gap between two successive vehicles of the target lane has a pace: the speed of the one ahead, or
of a faster one behind for who comes from behind, but no more than the driver may go. It holds a
window: the positions in which the driver, at that pace, would be accepted by the gap rule. Three
gaps are compared: the one beside, and the nearest ahead and behind, within sensor range, that have
a window. That whose window is reached soonest is sought.
"""

import math
from typing import Any

from marl_lanes.traffic.following.idm import free_road_term
from marl_lanes.traffic.machine.compiled import compiled, internal
from marl_lanes.traffic.machine.state import NONE, Phase
from marl_lanes.traffic.road.geometry import is_body_in
from marl_lanes.traffic.road.neighbors import neighbor_rank

_WAITING = int(Phase.WAITING)
_ENGAGED = int(Phase.ENGAGED)

_APPROACH_TIME = 5.0
"""[s] The distance to the aim over this time is the speed relative to the gap."""
_RESPONSE_TIME = 1.0
"""[s] In which the speed is corrected."""
_SLOWEST = 0.5
"""[1] Share of the gap's pace below which nobody falls back to reach it."""
_INSET = 3.0
"""[m] How far inside the window the aim lies, so that its edge is crossed."""


@internal
def needed_gap(
    speed: float, closing: float, desired_speed: float, profile: Any, constants: Any
) -> float:
    """The smallest gap that the rule accepts of a driver behind at ``speed`` [m]; inf if none is.

    Under the ACC model the standard IDM's, which is no smaller.
    """
    if constants.is_gap_kinematic:
        closing = max(0.0, closing)
        braking_way = closing * closing / (2.0 * constants.gap_max_braking)
        return float(constants.gap_minimum + constants.gap_time * speed + braking_way)
    braking = constants.gap_safe_braking - constants.gap_braking_margin
    allowed = 1.0 + braking / profile.max_acceleration
    free_road = free_road_term(speed, desired_speed, profile.exponent)
    if constants.is_sum_form:
        allowed -= free_road
    elif free_road > allowed:
        return math.inf
    if allowed <= 0.0:
        return math.inf
    dynamic = speed * (profile.time_headway + closing / profile.braking_scale)
    needed = (profile.minimum_gap + max(0.0, dynamic)) / math.sqrt(allowed)
    return float(max(needed, constants.gap_minimum))


@compiled
def travel_time(distance: float, speed: float, limit: float, top: float) -> float:
    """Least time to move ``distance`` and to stop there, with bounded acceleration and speed [s].

    Args:
        distance: either sign [m].
        speed: at the start, either sign [m/s].
        limit: of the acceleration, either way [m/s^2], > 0.
        top: of the speed in the direction of the way that is left [m/s]; inf where that way cannot
            be made.
    """
    if distance < speed * abs(speed) / (2.0 * limit):
        distance, speed = -distance, -speed
    peak = math.sqrt(limit * distance + 0.5 * speed * speed)
    if peak <= top:
        return (2.0 * peak - speed) / limit
    if top <= 0.0:
        return math.inf
    # Up to the top speed, on at it, and down from it.
    ramps = (top * top - 0.5 * speed * speed) / limit
    return (2.0 * top - speed) / limit + (distance - ramps) / top


@internal
def _window(
    car: Any,
    pace: float,
    front: int,
    rear: int,
    order: Any,
    vehicles: Any,
    profiles: Any,
    constants: Any,
) -> tuple[float, float]:
    """Ways from the car to the rear and to the front edge of the window, -inf, inf if open [m]."""
    low, high = -math.inf, math.inf
    if front > NONE:
        ahead = vehicles[order[front]]
        closing = pace - ahead.speed
        needed = needed_gap(pace, closing, car.desired_speed, profiles[car.profile], constants)
        high = ahead.position - constants.vehicle_length - needed - car.position
    if rear > NONE:
        behind = vehicles[order[rear]]
        closing = behind.speed - pace
        driver = profiles[behind.profile]
        needed = needed_gap(behind.speed, closing, behind.desired_speed, driver, constants)
        low = behind.position + constants.vehicle_length + needed - car.position
    return low, high


@internal
def aim_at(
    car: Any,
    front: int,
    rear: int,
    order: Any,
    vehicles: Any,
    profiles: Any,
    constants: Any,
) -> tuple[float, float, float]:
    """Pace [m/s], way to the window and way to the aim in it [m], of the gap between two ranks.

    The first way is inf where the gap has no window; the aim is then between its crossed edges.
    """
    top_speed = constants.gap_speed_factor * car.desired_speed
    ahead = front if front > NONE else rear
    pace = min(vehicles[order[ahead]].speed, top_speed)
    low, high = _window(car, pace, front, rear, order, vehicles, profiles, constants)
    if low > 0.0 and rear > NONE:
        # Who comes from behind must keep up with the one behind the gap.
        faster = min(vehicles[order[rear]].speed, top_speed)
        if faster > pace:
            pace = faster
            low, high = _window(car, pace, front, rear, order, vehicles, profiles, constants)
    if low > high:
        return pace, math.inf, 0.5 * (low + high)
    inset = min(_INSET, 0.5 * (high - low))
    return pace, min(max(0.0, low), high), min(max(0.0, low + inset), high - inset)


@internal
def _time_to(
    way: float, pace: float, car: Any, own: int, order: Any, vehicles: Any, profile: Any, c: Any
) -> float:
    """Time to the window [s]; inf where it cannot be reached.

    That is where the driver is too slow for it, or where its own leader, at its present speed,
    would be in the way.
    """
    if way == math.inf:
        return way
    top = c.gap_speed_factor * car.desired_speed - pace if way > 0.0 else (1.0 - _SLOWEST) * pace
    time = travel_time(way, car.speed - pace, profile.comfortable_braking, top)
    if own > NONE and time < math.inf:
        leader = vehicles[order[own]]
        room = leader.position + (leader.speed - pace) * time - c.vehicle_length - car.position
        if way > room - profile.minimum_gap - pace * profile.time_headway:
            return math.inf
    return time


@internal
def track(aim: float, pace: float, car: Any, profile: Any) -> float:
    """max(-b, (pace + max(aim/5 s, -pace/2) - v)/1 s): toward an aim that moves [m/s^2]."""
    wanted = pace + max(aim / _APPROACH_TIME, -(1.0 - _SLOWEST) * pace)
    return float(max((wanted - car.speed) / _RESPONSE_TIME, -profile.comfortable_braking))


@internal
def seek_gap(
    rank: int,
    car: Any,
    lane: int,
    order: Any,
    count: int,
    vehicles: Any,
    agents: Any,
    profiles: Any,
    constants: Any,
) -> float:
    """What a waiting driver wants to do for a gap in ``lane`` [m/s^2]; inf where it finds none.

    It is for the caller to bound it by what the driver's own leader allows.
    """
    profile = profiles[car.profile]
    own = neighbor_rank(rank, car.lane, -1, order, count, vehicles, agents)
    front = neighbor_rank(rank, lane, -1, order, count, vehicles, agents)
    nearest = neighbor_rank(rank, lane, 1, order, count, vehicles, agents)
    if front == NONE and nearest == NONE:
        return math.inf
    pace, way, aim = aim_at(car, front, nearest, order, vehicles, profiles, constants)
    best = _time_to(way, pace, car, own, order, vehicles, profile, constants)
    is_found, far = False, car.position + constants.sensor_range
    while front > NONE and not is_found and vehicles[order[front]].position < far:
        rear, front = front, neighbor_rank(front, lane, -1, order, count, vehicles, agents)
        speed, way, distance = aim_at(car, front, rear, order, vehicles, profiles, constants)
        time = _time_to(way, speed, car, own, order, vehicles, profile, constants)
        is_found = way < math.inf
        if time < best:
            best, aim, pace = time, distance, speed
    is_found, far, front = False, car.position - constants.sensor_range, nearest
    while front > NONE and not is_found and vehicles[order[front]].position > far:
        rear = neighbor_rank(front, lane, 1, order, count, vehicles, agents)
        speed, way, distance = aim_at(car, front, rear, order, vehicles, profiles, constants)
        time = _time_to(way, speed, car, own, order, vehicles, profile, constants)
        is_found = way < math.inf
        if time < best:
            best, aim, pace = time, distance, speed
        front = rear
    if best == math.inf:
        return best
    return track(aim, pace, car, profile)


@internal
def hold_gap(
    rank: int,
    car: Any,
    lane: int,
    order: Any,
    count: int,
    vehicles: Any,
    agents: Any,
    profiles: Any,
    constants: Any,
) -> float:
    """What keeps a driver in the gap of ``lane`` beside it [m/s^2]; inf where nobody is there."""
    front = neighbor_rank(rank, lane, -1, order, count, vehicles, agents)
    rear = neighbor_rank(rank, lane, 1, order, count, vehicles, agents)
    if front == NONE and rear == NONE:
        return math.inf
    pace, _, aim = aim_at(car, front, rear, order, vehicles, profiles, constants)
    return track(aim, pace, car, profiles[car.profile])


@internal
def seek_or_hold(
    rank: int,
    car: Any,
    agent: Any,
    order: Any,
    count: int,
    vehicles: Any,
    agents: Any,
    profiles: Any,
    constants: Any,
) -> tuple[float, float]:
    """What a driver with a live command does for its gap: two bounds, inf and -inf where none.

    The acceleration of a waiting one is at most the first; that of an engaged one toward its target
    lane's leader, before its body is in that lane, at least the second [m/s^2].
    """
    lane = agent.target_lane
    if agent.phase == _WAITING:
        seeking = seek_gap(rank, car, lane, order, count, vehicles, agents, profiles, constants)
        return seeking, -math.inf
    if agent.phase == _ENGAGED and not is_body_in(car, lane):
        holding = hold_gap(rank, car, lane, order, count, vehicles, agents, profiles, constants)
        return math.inf, holding
    return math.inf, -math.inf


@internal
def desired_speed_of(car: Any, agent: Any, seeking: float, constants: Any) -> float:
    """v0 of a vehicle with a live command [m/s].

    More where it seeks a gap. A speed gained so is kept until the body is in the target lane: else
    the gap that it accepted would close.
    """
    top_speed = constants.gap_speed_factor * car.desired_speed
    if agent.phase == _WAITING and seeking < math.inf:
        return float(top_speed)
    if agent.phase == _ENGAGED and not is_body_in(car, agent.target_lane):
        return float(min(max(car.desired_speed, car.speed), top_speed))
    return float(car.desired_speed)
