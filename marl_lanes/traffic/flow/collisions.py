"""Collisions: detection, records, and the removal of vehicles from the road."""

import math
from typing import Any

from marl_lanes.traffic.machine.compiled import compiled, internal
from marl_lanes.traffic.machine.state import NONE, CollisionKind, Fate
from marl_lanes.traffic.machine.team import any_member, is_team, meet, member, team_size
from marl_lanes.traffic.road.geometry import half_extent
from marl_lanes.traffic.road.neighbors import mean_length

STAYS = int(Fate.STAYS)
LEAVES = int(Fate.LEAVES)
COLLIDES = int(Fate.COLLIDES)
STRAYS = int(Fate.STRAYS)

_REAR_END = int(CollisionKind.REAR_END)
_SIDE = int(CollisionKind.SIDE)


@internal
def _is_separated(
    ahead: float, across: float, yaw: float, other_yaw: float, body: Any, other: Any
) -> bool:
    """Whether an axis of the rectangle at ``yaw`` separates it from the one at ``other_yaw``.

    ``body`` and ``other`` are the profiles with their sizes.
    """
    length, width = other.half_length, other.half_width
    cos_yaw, sin_yaw = math.cos(yaw), math.sin(yaw)
    along = abs(ahead * cos_yaw + across * sin_yaw)
    aside = abs(across * cos_yaw - ahead * sin_yaw)
    cos_turn, sin_turn = abs(math.cos(other_yaw - yaw)), abs(math.sin(other_yaw - yaw))
    return bool(
        along >= body.half_length + length * cos_turn + width * sin_turn
        or aside >= body.half_width + length * sin_turn + width * cos_turn
    )


@compiled
def is_overlapping(rear: Any, front: Any, profiles: Any) -> bool:
    """Whether the two rectangles overlap (separating axes; touching is not overlapping)."""
    ahead = front.position - rear.position
    across = front.lateral_position - rear.lateral_position
    body, other = profiles[rear.profile], profiles[front.profile]
    if abs(across) >= half_extent(rear.yaw, body) + half_extent(front.yaw, other):
        return False
    if rear.yaw == 0.0 and front.yaw == 0.0:
        return bool(abs(ahead) < body.half_length + other.half_length)
    return not _is_separated(ahead, across, rear.yaw, front.yaw, body, other) and not _is_separated(
        ahead, across, front.yaw, rear.yaw, other, body
    )


@internal
def _half_width(x: float, y: float, yaw: float, profile: Any) -> float:
    """Half of a body's width along the axis (x, y), times the axis's length."""
    along, across = math.cos(yaw), math.sin(yaw)
    length, width = abs(x * along + y * across), abs(y * along - x * across)
    return float(profile.half_length * length + profile.half_width * width)


@internal
def _moves_aside(car: Any, constants: Any) -> float:
    """Change of the lateral position in the step [m]."""
    return float(car.speed * math.sin(car.yaw) * constants.time_step)


@internal
def _is_far(along: float, across: float, length: float, width: float) -> bool:
    """Whether a relative motion is so long that only looking along it finds every contact.

    It is more than a body's ``length`` along the road, or half its ``width`` across [m].
    """
    return bool(abs(along) > length or abs(across) > 0.5 * width)


@compiled
def is_crossing(rear: Any, front: Any, along: float, across: float, profiles: Any) -> bool:
    """Whether the two rectangles overlap anywhere in the step.

    As in the step, they first turn and then move. Separating axes of a segment, the way of the
    centre of ``front`` relative to ``rear``, and the sum of both rectangles.

    Args:
        rear: one vehicle, after the step.
        front: the other one.
        along: how far ``front`` moved along the road, relative to ``rear`` [m].
        across: the same across the road [m].
        profiles: of the drivers, with the sizes of the bodies.
    """
    body, other = profiles[rear.profile], profiles[front.profile]
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
        reach = _half_width(x, y, rear.yaw, body) + _half_width(x, y, front.yaw, other)
        after = x * ahead + y * beside
        before = after - (x * along + y * across)
        if min(before, after) >= reach or max(before, after) <= -reach:
            return False
    return True


@internal
def _record(
    road: Any, rear: Any, front: Any, before: float, agents: Any, record: Any, profiles: Any
) -> None:
    """Fill in a record; |before| is their distance along the road before the step [m]."""
    record.step = road.step
    record.rear_id = rear.id
    record.front_id = front.id
    record.rear_command = NONE if rear.agent == NONE else agents[rear.agent].command
    record.front_command = NONE if front.agent == NONE else agents[front.agent].command
    # They were side by side a step ago, so the contact is lateral.
    record.kind = _SIDE if abs(before) < mean_length(rear, front, profiles) else _REAR_END
    record.position = rear.position
    record.closing_speed = rear.speed - front.speed


@internal
def _find_contact(
    rear: Any, front: Any, is_swept: bool, profiles: Any, constants: Any
) -> tuple[bool, bool, float]:
    """Whether two vehicles collide in the step; ``rear`` is behind ``front`` after it.

    ``is_swept``: whether there may be contacts that only looking along the step finds.

    Returns:
        Whether they do, whether ``front`` was behind before the step, and how far it was ahead of
        ``rear`` before the step [m].
    """
    ahead = front.position - rear.position
    before = ahead + (rear.speed - front.speed) * constants.time_step
    is_hit, has_passed = is_overlapping(rear, front, profiles), False
    if is_swept:
        along = front.advance - rear.advance
        across = _moves_aside(front, constants) - _moves_aside(rear, constants)
        length = mean_length(rear, front, profiles)
        width = profiles[rear.profile].half_width + profiles[front.profile].half_width
        if _is_far(along, across, length, width):
            has_passed = ahead < along
            if not is_hit:
                before = ahead - along
                is_hit = is_crossing(rear, front, along, across, profiles)
    return is_hit, has_passed, before


@internal
def _has_contact(
    road: Any,
    rank: int,
    reach: float,
    is_swept: bool,
    vehicles: Any,
    order: Any,
    profiles: Any,
    constants: Any,
) -> bool:
    """Whether a vehicle within ``reach`` behind the one at ``rank`` collides with it."""
    front = vehicles[order[rank]]
    for behind in range(rank + 1, road.num_vehicles):
        rear = vehicles[order[behind]]
        if front.position - rear.position >= reach:
            return False
        if _find_contact(rear, front, is_swept, profiles, constants)[0]:
            return True
    return False


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
    profiles: Any,
    constants: Any,
) -> None:
    """Record the vehicles within ``reach`` behind the one at ``rank`` that collide with it."""
    front = vehicles[order[rank]]
    for behind in range(rank + 1, road.num_vehicles):
        rear = vehicles[order[behind]]
        if front.position - rear.position >= reach:
            break
        is_hit, has_passed, before = _find_contact(rear, front, is_swept, profiles, constants)
        if is_hit:
            record = collisions[road.num_collisions % collisions.shape[0]]
            # The rear one is the one that was behind before the step.
            first, second = (front, rear) if has_passed else (rear, front)
            _record(road, first, second, before, agents, record, profiles)
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
    profiles: Any,
    constants: Any,
) -> bool:
    """Record every pair that collides in the step, and mark both vehicles.

    A pair collides if it overlaps after the step or, where ``_is_far`` holds for its relative
    motion and its mean size, anywhere in the step. ``along`` and ``across`` are the longest
    relative motions of any two vehicles [m].

    Returns:
        Whether there is such a pair.
    """
    reach = constants.longest_diagonal
    is_swept = _is_far(along, across, constants.shortest_length, constants.narrowest_width)
    if is_swept:
        reach += along
    if is_team():
        # A record has a place in their order, so the first member writes them; they are rare.
        is_found = False
        for rank in range(member(), road.num_vehicles, team_size()):
            is_found = is_found or _has_contact(
                road, rank, reach, is_swept, vehicles, order, profiles, constants
            )
        if not any_member(is_found):
            return False
    num_before = road.num_collisions
    if member() == 0:
        position = vehicles[order[0]].position
        for rank in range(1, road.num_vehicles):
            ahead, position = position, vehicles[order[rank]].position
            if ahead - position < reach:
                _compare(
                    road,
                    rank - 1,
                    reach,
                    is_swept,
                    vehicles,
                    order,
                    agents,
                    collisions,
                    profiles,
                    constants,
                )
    meet()
    return bool(is_team() or road.num_collisions > num_before)


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
