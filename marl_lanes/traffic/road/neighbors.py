"""The vehicles ahead and behind in a lane, found along the order of decreasing position."""

from typing import Any

from marl_lanes.traffic.machine.compiled import compiled, internal
from marl_lanes.traffic.machine.state import NONE, Phase
from marl_lanes.traffic.machine.team import is_team
from marl_lanes.traffic.road.geometry import is_body_in

_ENGAGED = int(Phase.ENGAGED)


@internal
def insert_by_position(order: Any, rank: int, vehicles: Any) -> None:
    """Move the vehicle at ``rank`` in the order ahead of the vehicles that it has passed.

    Called for all ranks from the front this is an insertion sort, nearly linear because the order
    hardly changes in a step.
    """
    slot = order[rank]
    position = vehicles[slot].position
    place = rank
    while place > 0 and vehicles[order[place - 1]].position < position:
        order[place] = order[place - 1]
        place -= 1
    if place != rank:
        order[place] = slot


@internal
def is_entering(car: Any, lane: int, agents: Any) -> bool:
    """Whether the car is engaged or moving over toward the lane."""
    if car.agent == NONE:
        return bool(car.moving_over != 0 and car.lane == lane)
    agent = agents[car.agent]
    return bool(agent.phase == _ENGAGED and agent.target_lane == lane)


@internal
def is_in_lane(car: Any, lane: int, agents: Any) -> bool:
    """Whether the body overlaps the lane, or the car is engaged or moving over toward it."""
    return bool(is_body_in(car, lane) or is_entering(car, lane, agents))


@internal
def _stop(stride: int, count: int) -> int:
    """The rank after the last one in a direction.

    A loop compares with it alone: CUDA's compiler takes a loop that goes down from ``count - 1``
    while ``0 <= rank < count`` for one that ends after its first round (NVVM 13.0 and 13.5).
    """
    return NONE if stride < 0 else count


@internal
def neighbor_rank(
    rank: int, lane: int, stride: int, order: Any, count: int, vehicles: Any, agents: Any
) -> int:
    """Rank of the nearest vehicle in the lane, ahead of ``rank`` (stride -1) or behind it (+1)."""
    other, stop = rank + stride, _stop(stride, count)
    while other != stop:
        if is_in_lane(vehicles[order[other]], lane, agents):
            return other
        other += stride
    return NONE


@internal
def neighbor_in_lane(
    rank: int, lane: int, stride: int, order: Any, count: int, vehicles: Any, agents: Any
) -> int:
    """Slot of the nearest vehicle in the lane, ahead of ``rank`` (stride -1) or behind it (+1)."""
    other, stop = rank + stride, _stop(stride, count)
    while other != stop:
        slot = order[other]
        if is_in_lane(vehicles[slot], lane, agents):
            return int(slot)
        other += stride
    return NONE


@internal
def neighbors_in_lanes(
    rank: int,
    stride: int,
    lane: int,
    other_lane: int,
    order: Any,
    count: int,
    vehicles: Any,
    agents: Any,
) -> tuple[int, int]:
    """``neighbor_in_lane`` for two lanes at once."""
    neighbor = other_neighbor = NONE
    at, stop = rank + stride, _stop(stride, count)
    while at != stop and (neighbor == NONE or other_neighbor == NONE):
        slot = int(order[at])
        if neighbor == NONE and is_in_lane(vehicles[slot], lane, agents):
            neighbor = slot
        if other_neighbor == NONE and is_in_lane(vehicles[slot], other_lane, agents):
            other_neighbor = slot
        at += stride
    return neighbor, other_neighbor


@internal
def body_ahead(rank: int, lane: int, lanes: Any, order: Any, vehicles: Any) -> int:
    """Slot of the nearest vehicle ahead of ``rank`` whose body overlaps the lane, or NONE.

    It is the last one that the sweep over the vehicles has seen in the lane. A team does not sweep:
    each member looks along the order.
    """
    if not is_team():
        return int(lanes[lane].nearest)
    other = rank - 1
    while other != NONE:
        slot = int(order[other])
        if is_body_in(vehicles[slot], lane):
            return slot
        other -= 1
    return NONE


@internal
def entering_ahead(rank: int, lane: int, lanes: Any, order: Any, vehicles: Any, agents: Any) -> int:
    """Slot of the nearest vehicle ahead of ``rank`` that is entering the lane, or NONE.

    As ``body_ahead`` finds it.
    """
    if not is_team():
        return int(lanes[lane].nearest_engaged)
    other = rank - 1
    while other != NONE:
        slot = int(order[other])
        if is_entering(vehicles[slot], lane, agents):
            return slot
        other -= 1
    return NONE


@internal
def find_rank(slot: int, order: Any) -> int:
    """Place of the vehicle in the order from the front of the road."""
    rank = 0
    while order[rank] != slot:
        rank += 1
    return rank


@internal
def find_agent_neighbors(
    agent: Any, rank: int, order: Any, count: int, vehicles: Any, agents: Any
) -> None:
    """Set the agent's leader and follower in its origin and in its target lane.

    ``rank`` is its vehicle's place in the order.
    """
    agent.leader, agent.target_leader = neighbors_in_lanes(
        rank, -1, agent.origin_lane, agent.target_lane, order, count, vehicles, agents
    )
    agent.follower, agent.target_follower = neighbors_in_lanes(
        rank, 1, agent.origin_lane, agent.target_lane, order, count, vehicles, agents
    )


@internal
def mean_length(car: Any, other: Any, profiles: Any) -> Any:
    """Mean length of two bodies: the distance of their centres where their bumpers touch [m]."""
    return profiles[car.profile].half_length + profiles[other.profile].half_length


@compiled
def bumper_gap(rear: Any, front: Any, profiles: Any) -> Any:
    """Bumper-to-bumper distance [m], negative where the bodies overlap lengthwise."""
    half_lengths = profiles[rear.profile].half_length + profiles[front.profile].half_length
    return front.position - rear.position - half_lengths
