"""Yielding by moving over: a cooperative follower leaves its lane to make room for a changer.

It moves to the lane beyond, and counts as being in that lane from the decision on, like an engaged
changer. The move ends once the follower has settled there. It is taken back if the gap becomes
unsafe before the body has reached the marking.
"""

from typing import Any

from marl_lanes.traffic.command.gap import is_gap_safe
from marl_lanes.traffic.command.outcome import has_arrived
from marl_lanes.traffic.driving.dispositions import drive_alone, yield_to
from marl_lanes.traffic.machine.compiled import internal
from marl_lanes.traffic.machine.state import NONE, Disposition
from marl_lanes.traffic.road.geometry import is_body_in, is_wholly_in, lane_centre, road_turn_rate
from marl_lanes.traffic.road.neighbors import neighbor_in_lane

_COOPERATIVE = int(Disposition.COOPERATIVE)
_MIN_SPEED = 5.0
"""[m/s] A slower vehicle would overlap two lanes for a long time."""


@internal
def _is_settled(car: Any, arcs: Any, constants: Any) -> bool:
    """Whether the body is in the lane that the car keeps, and the completion criterion holds."""
    deviation = lane_centre(car.lane, constants.lane_width) - car.lateral_position
    turning = car.yaw_rate - road_turn_rate(car, arcs)
    is_inside = is_wholly_in(car)
    return bool(is_inside and has_arrived(deviation, car, turning, constants))


@internal
def _is_lane_free(
    rank: int,
    lane: int,
    braking: float,
    order: Any,
    count: int,
    vehicles: Any,
    agents: Any,
    profiles: Any,
    constants: Any,
) -> bool:
    """Whether the gap rule accepts the gaps to the vehicles ahead and behind in the lane.

    ``braking`` is b_safe of the rule [m/s^2].
    """
    car = vehicles[order[rank]]
    leader = neighbor_in_lane(rank, lane, -1, order, count, vehicles, agents)
    if leader > NONE and not is_gap_safe(car, vehicles[leader], braking, profiles, constants):
        return False
    follower = neighbor_in_lane(rank, lane, 1, order, count, vehicles, agents)
    return follower == NONE or is_gap_safe(vehicles[follower], car, braking, profiles, constants)


@internal
def _has_reason(
    rank: int,
    lane: int,
    order: Any,
    count: int,
    vehicles: Any,
    agents: Any,
    profiles: Any,
    constants: Any,
) -> bool:
    """Whether the driver would brake for its changer, and harder than in the lane beyond."""
    car = vehicles[order[rank]]
    yielding = yield_to(car, vehicles[car.changer], profiles, constants)
    if yielding >= 0.0:
        return False
    leader = neighbor_in_lane(rank, lane, -1, order, count, vehicles, agents)
    beyond = drive_alone(car, leader, vehicles, profiles, constants)
    return bool(beyond > max(yielding, -constants.cooperative_max_braking))


@internal
def _direction(car: Any, vehicles: Any, agents: Any, constants: Any) -> int:
    """Direction to the lane beyond the driver's own, away from its changer: +1 or -1, or 0.

    0 if there is no such lane, if the changer does not move to the driver's lane, or if its body is
    there already.
    """
    changer = vehicles[car.changer]
    agent = agents[changer.agent]
    if agent.target_lane != car.lane or is_body_in(changer, car.lane):
        return 0
    beyond = car.lane + agent.direction
    if not 0 <= beyond < constants.num_lanes:
        return 0
    return int(agent.direction)


@internal
def move_over(
    road: Any,
    order: Any,
    vehicles: Any,
    agents: Any,
    profiles: Any,
    arcs: Any,
    constants: Any,
) -> None:
    """Begin, take back and end moves, from the front of the road to its rear.

    In this order, so that a gap taken by one vehicle is taken for the next. A move is begun only by
    cooperative drivers without a live command, at 5 m/s or faster and settled in their lane.
    """
    count = road.num_vehicles
    safe = constants.gap_safe_braking
    accepted = safe - constants.gap_braking_margin
    for rank in range(count):
        car = vehicles[order[rank]]
        if car.moving_over != 0:
            if _is_settled(car, arcs, constants):
                car.moving_over = 0
            elif not is_body_in(car, car.lane) and not _is_lane_free(
                rank, car.lane, safe, order, count, vehicles, agents, profiles, constants
            ):
                car.lane -= car.moving_over
                car.moving_over = 0
                road.num_moves_returned += 1
        elif (
            car.changer > NONE
            and car.disposition == _COOPERATIVE
            and car.agent == NONE
            and car.speed >= _MIN_SPEED
        ):
            direction = _direction(car, vehicles, agents, constants)
            lane = car.lane + direction
            if (
                direction != 0
                and _is_settled(car, arcs, constants)
                and _is_lane_free(
                    rank, lane, accepted, order, count, vehicles, agents, profiles, constants
                )
                and _has_reason(rank, lane, order, count, vehicles, agents, profiles, constants)
            ):
                car.lane = lane
                car.moving_over = direction
                road.num_moves_over += 1
