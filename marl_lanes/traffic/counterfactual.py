"""Accelerations of a lane changer and of its follower if there were no lane change."""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from marl_lanes.traffic.driving.dispositions import comfortable_in_curves, drive_alone
from marl_lanes.traffic.machine.compiled import compiled, entry_point, internal
from marl_lanes.traffic.machine.state import NONE, ROAD, VEHICLE, Phase, State, structure
from marl_lanes.traffic.parameters import ARC, CONSTANTS, PROFILE, Parameters
from marl_lanes.traffic.road.geometry import is_body_in
from marl_lanes.traffic.roles.changer import CHANGER

_ENGAGED = int(Phase.ENGAGED)


def accelerations_without_change(
    state: State, parameters: Parameters
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Plain car following in the present state, as if no agent changed lanes.

    The changer follows only the nearest body ahead in its origin lane. Its follower in the target
    lane follows the nearest body ahead in the lanes of its own body, without the changer, with the
    parameters of its profile for every disposition. Both slow down for curves, and brake at most
    with ``vehicle.max_braking``.

    Returns:
        Accelerations of the changers and of their followers, each (E, A) float64 [m/s^2]; nan if
        the agent does not steer, the second also if there is no follower.
    """
    changers = np.full(state.agents.shape, np.nan)
    followers = np.full(state.agents.shape, np.nan)
    tables = state.roads, state.vehicles, state.order, state.agents
    given = parameters.profiles, parameters.arcs, parameters.constants
    _kernel()(*tables, *given, changers, followers)
    return changers, followers


@cache
def _kernel() -> Callable[..., None]:
    """``_imagine``, compiled for the types of all its calls."""
    roads, order = np.empty(1, structure(ROAD)), np.empty((1, 1), np.uint32)
    vehicles, agents = (np.empty((1, 1), kind) for kind in (structure(VEHICLE), CHANGER.dtype))
    profiles, arcs, constants = (
        np.empty(1, structure(table)) for table in (PROFILE, ARC, CONSTANTS)
    )
    found = np.empty((1, 1))
    types = (roads, vehicles, order, agents, profiles, arcs, constants, found, found)
    return entry_point(_imagine, types)


@internal
def _body_ahead(slot: int, lane: int, absent: int, order: Any, count: int, vehicles: Any) -> int:
    """Slot of the nearest body ahead of ``slot`` in the lane, without ``absent``; or NONE."""
    nearest = NONE
    for rank in range(count):
        other = int(order[rank])
        if other == slot:
            return nearest
        if other != absent and is_body_in(vehicles[other], lane):
            nearest = other
    return nearest


@compiled
def _imagine(
    roads: Any,
    vehicles: Any,
    order: Any,
    agents: Any,
    profiles: Any,
    arcs: Any,
    constants: Any,
    changers: Any,
    followers: Any,
) -> None:
    c = constants[0]
    for env in range(agents.shape[0]):
        cars, count = vehicles[env], roads[env].num_vehicles
        for index in range(agents.shape[1]):
            agent = agents[env, index]
            if agent.phase < _ENGAGED:
                continue
            car = cars[agent.vehicle]
            front = _body_ahead(agent.vehicle, agent.origin_lane, NONE, order[env], count, cars)
            alone = drive_alone(car, front, cars, profiles, c)
            bent = comfortable_in_curves(car, profiles[car.profile], arcs, c)
            changers[env, index] = max(min(alone, bent), -c.max_braking)
            slot = agent.target_follower
            if slot == NONE:
                continue
            behind = cars[slot]
            smallest = comfortable_in_curves(behind, profiles[behind.profile], arcs, c)
            for lane in range(behind.lane_low, behind.lane_high + 1):
                front = _body_ahead(slot, lane, agent.vehicle, order[env], count, cars)
                alone = drive_alone(behind, front, cars, profiles, c)
                smallest = min(smallest, alone)
            followers[env, index] = max(smallest, -c.max_braking)
