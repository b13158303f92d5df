"""Collisions: detection, records, and the removal of vehicles from the road."""

import math
from typing import Any

from marl_lanes.traffic.machine.compiled import compiled, internal
from marl_lanes.traffic.machine.convergence import converge
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
def _half_width(x: float, y: float, yaw: float, constants: Any) -> float:
    """Half of a body's width along the axis (x, y), times the axis's length."""
    along, across = math.cos(yaw), math.sin(yaw)
    length, width = abs(x * along + y * across), abs(y * along - x * across)
    return 0.5 * float(constants.vehicle_length * length + constants.vehicle_width * width)


@internal
def _moves_aside(car: Any, constants: Any) -> float:
    """Change of the lateral position in the step [m]."""
    return float(car.speed * math.sin(car.yaw) * constants.time_step)


@internal
def _is_far(along: float, across: float, constants: Any) -> bool:
    """Whether a relative motion is so long that only looking along it finds every contact.

    It is more than a body's length along the road, or half its width across.
    """
    return bool(
        abs(along) > constants.vehicle_length or abs(across) > 0.5 * constants.vehicle_width
    )


@compiled
def is_crossing(rear: Any, front: Any, along: float, across: float, constants: Any) -> bool:
    """Whether the two rectangles overlap anywhere in the step.

    As in the step, they first turn and then move. Separating axes of a segment, the way of the
    centre of ``front`` relative to ``rear``, and the sum of both rectangles.

    Args:
        rear: one vehicle, after the step.
        front: the other one.
        along: how far ``front`` moved along the road, relative to ``rear`` [m].
        across: the same across the road [m].
        constants: of the scenario.
    """
    ahead = front.position - rear.position
    beside = front.lateral_position - rear.lateral_position
    for axis in range(5):
        if axis == 0:
            x, y = -across, along
        else:
            yaw = rear.yaw if axis < 3 else front.yaw
            x, y = math.cos(yaw), math.sin(yaw)
            if axis % 2 == 0:
                x, y = -y, x
        reach = _half_width(x, y, rear.yaw, constants) + _half_width(x, y, front.yaw, constants)
        after = x * ahead + y * beside
        before = after - (x * along + y * across)
        if min(before, after) >= reach or max(before, after) <= -reach:
            return False
    return True


@internal
def _record(
    road: Any, rear: Any, front: Any, before: float, agents: Any, record: Any, constants: Any
) -> None:
    """Fill in a record; |before| is their distance along the road before the step [m]."""
    record.step = road.step
    record.rear_id = rear.id
    record.front_id = front.id
    record.rear_command = NONE if rear.agent == NONE else agents[rear.agent].command
    record.front_command = NONE if front.agent == NONE else agents[front.agent].command
    # They were side by side a step ago, so the contact is lateral.
    record.kind = _SIDE if abs(before) < constants.vehicle_length else _REAR_END
    record.position = rear.position
    record.closing_speed = rear.speed - front.speed


@internal
def _compare(
    road: Any,
    rank: int,
    reach: float,
    is_swept: bool,
    vehicles: Any,
    order: Any,
    agents: Any,
    collisions: Any,
    constants: Any,
) -> None:
    """Record the vehicles within ``reach`` behind the one at ``rank`` that collide with it.

    ``is_swept``: whether there may be contacts that only looking along the step finds.
    """
    front = vehicles[order[rank]]
    for behind in range(rank + 1, road.num_vehicles):
        rear = vehicles[order[behind]]
        ahead = front.position - rear.position
        if ahead >= reach:
            break
        before = ahead + (rear.speed - front.speed) * constants.time_step
        is_hit, has_passed = is_overlapping(rear, front, constants), False
        if is_swept:
            along = front.advance - rear.advance
            across = _moves_aside(front, constants) - _moves_aside(rear, constants)
            if _is_far(along, across, constants):
                has_passed = ahead < along
                if not is_hit:
                    before = ahead - along
                    is_hit = is_crossing(rear, front, along, across, constants)
        if is_hit:
            record = collisions[road.num_collisions % collisions.shape[0]]
            # The rear one is the one that was behind before the step.
            first, second = (front, rear) if has_passed else (rear, front)
            _record(road, first, second, before, agents, record, constants)
            road.num_collisions += 1
            rear.fate = COLLIDES
            front.fate = COLLIDES


@internal
def detect_collisions(
    road: Any,
    along: float,
    across: float,
    vehicles: Any,
    order: Any,
    agents: Any,
    collisions: Any,
    constants: Any,
) -> bool:
    """Record every pair that collides in the step, and mark both vehicles.

    A pair collides if it overlaps after the step or, where ``_is_far`` holds for its relative
    motion, anywhere in the step. ``along`` and ``across`` are the longest relative motions of any
    two vehicles [m].

    Returns:
        Whether there is such a pair.
    """
    num_before = road.num_collisions
    length, width = constants.vehicle_length, constants.vehicle_width
    reach = math.sqrt(length * length + width * width)
    is_swept = _is_far(along, across, constants)
    if is_swept:
        reach += along
    position = vehicles[order[0]].position
    rank, count = 1, road.num_vehicles
    while rank < count:
        converge()
        ahead = math.inf
        while rank < count and ahead - position >= reach:
            ahead = position
            position = vehicles[order[rank]].position
            rank += 1
        if ahead - position < reach:
            _compare(
                road, rank - 2, reach, is_swept, vehicles, order, agents, collisions, constants
            )
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
