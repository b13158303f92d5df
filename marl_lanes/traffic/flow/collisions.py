"""Collisions: detection, records, and the removal of vehicles from the road."""

import math
from typing import Any

from marl_lanes.traffic.machine.compiled import compiled, internal
from marl_lanes.traffic.machine.state import NONE, CollisionKind, Fate
from marl_lanes.traffic.road.geometry import half_extent

STAYS = int(Fate.STAYS)
LEAVES = int(Fate.LEAVES)
COLLIDES = int(Fate.COLLIDES)
STRAYS = int(Fate.STRAYS)

_REAR_END = int(CollisionKind.REAR_END)
_SIDE = int(CollisionKind.SIDE)


@internal
def _is_separated(ahead: float, across: float, yaw: float, other: float, constants: Any) -> bool:
    """Whether an axis of the rectangle at ``yaw`` separates it from the one at yaw ``other``."""
    length, width = 0.5 * constants.vehicle_length, 0.5 * constants.vehicle_width
    cos_yaw, sin_yaw = math.cos(yaw), math.sin(yaw)
    along = abs(ahead * cos_yaw + across * sin_yaw)
    aside = abs(across * cos_yaw - ahead * sin_yaw)
    cos_turn, sin_turn = abs(math.cos(other - yaw)), abs(math.sin(other - yaw))
    return bool(
        along >= length + length * cos_turn + width * sin_turn
        or aside >= width + length * sin_turn + width * cos_turn
    )


@compiled
def is_overlapping(rear: Any, front: Any, constants: Any) -> bool:
    """Whether the two rectangles overlap (separating axes; touching is not overlapping)."""
    ahead = front.position - rear.position
    across = front.lateral_position - rear.lateral_position
    if abs(across) >= half_extent(rear.yaw, constants) + half_extent(front.yaw, constants):
        return False
    if rear.yaw == 0.0 and front.yaw == 0.0:
        return bool(abs(ahead) < constants.vehicle_length)
    return not _is_separated(ahead, across, rear.yaw, front.yaw, constants) and not _is_separated(
        ahead, across, front.yaw, rear.yaw, constants
    )


@internal
def _record(road: Any, rear: Any, front: Any, agents: Any, record: Any, constants: Any) -> None:
    closing = rear.speed - front.speed
    gap_before = front.position - rear.position + closing * constants.time_step
    record.step = road.step
    record.rear_id = rear.id
    record.front_id = front.id
    record.rear_command = NONE if rear.agent == NONE else agents[rear.agent].command
    record.front_command = NONE if front.agent == NONE else agents[front.agent].command
    # They were side by side a step ago, so the contact is lateral.
    record.kind = _SIDE if abs(gap_before) < constants.vehicle_length else _REAR_END
    record.position = rear.position
    record.closing_speed = closing


@internal
def _compare(
    road: Any,
    rank: int,
    reach: float,
    vehicles: Any,
    order: Any,
    agents: Any,
    collisions: Any,
    constants: Any,
) -> None:
    """Record the vehicles within ``reach`` behind the one at ``rank`` that overlap with it."""
    front = vehicles[order[rank]]
    for behind in range(rank + 1, road.num_vehicles):
        rear = vehicles[order[behind]]
        if front.position - rear.position >= reach:
            break
        if is_overlapping(rear, front, constants):
            newest = road.num_collisions % collisions.shape[0]
            _record(road, rear, front, agents, collisions[newest], constants)
            road.num_collisions += 1
            rear.fate = COLLIDES
            front.fate = COLLIDES


@internal
def detect_collisions(
    road: Any, vehicles: Any, order: Any, agents: Any, collisions: Any, constants: Any
) -> bool:
    """Record every overlapping pair and mark both vehicles.

    Returns:
        Whether there is such a pair.
    """
    num_before = road.num_collisions
    length, width = constants.vehicle_length, constants.vehicle_width
    reach = math.sqrt(length * length + width * width)
    position = vehicles[order[0]].position
    for rank in range(1, road.num_vehicles):
        ahead = position
        position = vehicles[order[rank]].position
        if ahead - position < reach:
            _compare(road, rank - 1, reach, vehicles, order, agents, collisions, constants)
    return bool(road.num_collisions > num_before)


@internal
def remove_vehicles(road: Any, vehicles: Any, order: Any) -> None:
    """Remove the marked vehicles from the road and from the order, and count them."""
    kept = 0
    for rank in range(road.num_vehicles):
        slot = order[rank]
        car = vehicles[slot]
        if car.fate == STAYS:
            order[kept] = slot
            kept += 1
            continue
        if car.fate == COLLIDES:
            road.num_collided += 1
        else:
            road.num_left += 1
            if car.fate == STRAYS:
                road.num_off_road += 1
        car.id = NONE
        car.agent = NONE
        road.num_removed += 1
    road.num_vehicles = kept


@internal
def free_slots(road: Any, vehicles: Any) -> None:
    """Free the slots of the vehicles removed in the step before, for departures.

    Until then their records can be read, for example to see how a command ended.
    """
    if road.num_removed > 0:
        for slot in range(vehicles.shape[0]):
            if vehicles[slot].id == NONE:
                vehicles[slot].fate = STAYS
        road.num_removed = 0
