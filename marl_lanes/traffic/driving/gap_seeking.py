"""A waiting driver seeks a gap in the target lane: choice of the gap, and approach to it.

A gap is between two successive vehicles of the target lane. Its pace is the speed of its front
vehicle, or of a faster rear vehicle if the driver comes from behind; at most the driver's top speed
for a gap. Its window is the range of positions at which the gap rule accepts the driver at this
pace. Three gaps are compared: the one beside the driver, and the nearest ones ahead and behind,
within sensor range, that have a window. The driver seeks the one whose window it reaches soonest.
"""

import math
from typing import Any

from marl_lanes.traffic.following.idm import free_road_term
from marl_lanes.traffic.machine.compiled import compiled, internal
from marl_lanes.traffic.machine.state import NONE, Phase
from marl_lanes.traffic.road.geometry import is_body_in
from marl_lanes.traffic.road.neighbors import mean_length, neighbor_rank

_WAITING = int(Phase.WAITING)
_ENGAGED = int(Phase.ENGAGED)

_APPROACH_TIME = 5.0
"""[s] Distance to the aim divided by the wanted speed relative to the gap."""
_RESPONSE_TIME = 1.0
"""[s] Speed error divided by the acceleration."""
_SLOWEST = 0.5
"""[1] Lowest wanted speed while falling back to a gap, as a share of its pace."""
_INSET = 3.0
"""[m] Distance of the aim from the window's edges, so that the driver crosses the edge."""


@internal
def needed_gap(
    speed: float, closing: float, desired_speed: float, profile: Any, constants: Any
) -> float:
    """The smallest gap that the gap rule accepts for a rear driver at ``speed``, or inf [m].

    For the ACC model that of the standard IDM, which is not smaller.
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
        distance: of either sign [m].
        speed: at the start, of either sign [m/s].
        limit: of |acceleration| [m/s^2], > 0.
        top: largest speed in the direction of the distance that would remain after braking to a
            stop [m/s].

    Returns:
        The time; inf if a distance remains and ``top`` is not positive.
    """
    if distance < speed * abs(speed) / (2.0 * limit):
        distance, speed = -distance, -speed
    # Not below 0: rounding may make it so.
    peak = math.sqrt(max(0.0, limit * distance + 0.5 * speed * speed))
    if peak <= top:
        return (2.0 * peak - speed) / limit
    if top <= 0.0:
        return math.inf
    # Accelerate to the top speed, keep it, brake.
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
    """Distances from the car to the window's rear and front edges [m]; -inf, inf if open."""
    low, high = -math.inf, math.inf
    if front > NONE:
        ahead = vehicles[order[front]]
        closing = pace - ahead.speed
        needed = needed_gap(pace, closing, car.desired_speed, profiles[car.profile], constants)
        high = ahead.position - mean_length(car, ahead, profiles) - needed - car.position
    if rear > NONE:
        behind = vehicles[order[rear]]
        closing = behind.speed - pace
        driver = profiles[behind.profile]
        needed = needed_gap(behind.speed, closing, behind.desired_speed, driver, constants)
        low = behind.position + mean_length(car, behind, profiles) + needed - car.position
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
    """Pace of the gap between two ranks [m/s], distances to its window and to the aim in it [m].

    Without a window the first distance is inf, and the aim is midway between the crossed edges: inf
    or -inf if no gap is wide enough for the one behind or ahead, 0 if for neither.
    """
    top_speed = constants.gap_speed_factor * car.desired_speed
    ahead = front if front > NONE else rear
    pace = min(vehicles[order[ahead]].speed, top_speed)
    while True:
        low, high = _window(car, pace, front, rear, order, vehicles, profiles, constants)
        if low <= 0.0 or rear == NONE:
            break
        # A driver that comes from behind must keep up with the gap's rear vehicle.
        faster = min(vehicles[order[rear]].speed, top_speed)
        if faster <= pace:
            break
        pace = faster
    if low > high or low == math.inf or high == -math.inf:
        is_neither = low == math.inf and high == -math.inf
        return pace, math.inf, 0.0 if is_neither else 0.5 * (low + high)
    inset = min(_INSET, 0.5 * (high - low))
    return pace, min(max(0.0, low), high), min(max(0.0, low + inset), high - inset)


@internal
def _time_to(
    way: float, pace: float, car: Any, own: int, order: Any, vehicles: Any, profiles: Any, c: Any
) -> float:
    """Time to the window [s]; inf if it cannot be reached.

    The driver may be too slow for it, or its own leader, at its present speed, may be in the way.
    """
    if way == math.inf:
        return way
    profile = profiles[car.profile]
    top = c.gap_speed_factor * car.desired_speed - pace if way > 0.0 else (1.0 - _SLOWEST) * pace
    time = travel_time(way, car.speed - pace, profile.comfortable_braking, top)
    if own > NONE and time < math.inf:
        leader = vehicles[order[own]]
        reach = leader.position + (leader.speed - pace) * time
        room = reach - mean_length(car, leader, profiles) - car.position
        if way > room - profile.minimum_gap - pace * profile.time_headway:
            return math.inf
    return time


@internal
def track(aim: float, pace: float, car: Any, profile: Any) -> float:
    """max(-b, (pace + max(aim/5 s, -pace/2) - v)/1 s): toward a moving aim [m/s^2]."""
    wanted = pace + max(aim / _APPROACH_TIME, -(1.0 - _SLOWEST) * pace)
    return float(max((wanted - car.speed) / _RESPONSE_TIME, -profile.comfortable_braking))


@internal
def _is_seen(rank: int, stride: int, car: Any, order: Any, vehicles: Any, constants: Any) -> bool:
    """Whether there is a vehicle at the rank, within sensor range in that direction."""
    if rank == NONE:
        return False
    position = vehicles[order[rank]].position
    if stride < 0:
        return bool(position < car.position + constants.sensor_range)
    return bool(position > car.position - constants.sensor_range)


@internal
def _approach_gap(
    rank: int,
    car: Any,
    lane: int,
    is_seeking: bool,
    order: Any,
    count: int,
    vehicles: Any,
    agents: Any,
    profiles: Any,
    constants: Any,
) -> float:
    """Acceleration toward the gap beside the driver or, if it seeks, the best one [m/s^2].

    inf if ``lane`` is empty, or if it finds none. The caller must limit it by car following behind
    the driver's own leader.
    """
    own = neighbor_rank(rank, car.lane, -1, order, count, vehicles, agents)
    beside = neighbor_rank(rank, lane, -1, order, count, vehicles, agents)
    nearest = neighbor_rank(rank, lane, 1, order, count, vehicles, agents)
    if beside == NONE and nearest == NONE:
        return math.inf
    front, rear, stride = beside, nearest, 0
    best, aim, pace = math.inf, 0.0, 0.0
    # One loop, so that the compiled code of a gap is there once.
    while True:
        speed, way, distance = aim_at(car, front, rear, order, vehicles, profiles, constants)
        time = 0.0
        if is_seeking:
            time = _time_to(way, speed, car, own, order, vehicles, profiles, constants)
        if stride == 0 or time < best:
            best, aim, pace = time, distance, speed
        if not is_seeking:
            break
        # The next one ahead, until one has a window; then the next one behind.
        edge = front if stride < 1 else rear
        if stride != 0 and way < math.inf:
            edge = NONE
        if stride < 1:
            stride = -1
            if not _is_seen(edge, stride, car, order, vehicles, constants):
                stride, edge = 1, nearest
        if stride == 1 and not _is_seen(edge, stride, car, order, vehicles, constants):
            break
        other = neighbor_rank(edge, lane, stride, order, count, vehicles, agents)
        front, rear = (other, edge) if stride < 0 else (edge, other)
    if best == math.inf:
        return best
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
    """Two bounds of the acceleration of a driver with a live command, for its gap [m/s^2].

    The first is an upper bound while it waits, otherwise inf. The second is a lower bound of its
    acceleration toward the target lane's leader while it is engaged and its body is not in that
    lane, otherwise -inf.
    """
    lane, is_seeking = agent.target_lane, agent.phase == _WAITING
    if not is_seeking and (agent.phase != _ENGAGED or is_body_in(car, lane)):
        return math.inf, -math.inf
    approach = _approach_gap(
        rank, car, lane, is_seeking, order, count, vehicles, agents, profiles, constants
    )
    return (approach, -math.inf) if is_seeking else (math.inf, approach)


@internal
def desired_speed_of(car: Any, agent: Any, seeking: float, constants: Any) -> float:
    """v0 of a vehicle with a live command [m/s].

    It is higher while the vehicle seeks a gap. The vehicle keeps a speed gained in this way until
    its body is in the target lane; otherwise the gap that it accepted would close.
    """
    top_speed = constants.gap_speed_factor * car.desired_speed
    if agent.phase == _WAITING and seeking < math.inf:
        return float(top_speed)
    if agent.phase == _ENGAGED and not is_body_in(car, agent.target_lane):
        return float(min(max(car.desired_speed, car.speed), top_speed))
    return float(car.desired_speed)
