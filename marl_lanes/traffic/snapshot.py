"""Snapshots of roads: every byte, with digests, and a check of everything that kernels rely on.

Kernels use indices and counts without checking them, so a wrong one would crash the interpreter or
never end. A digest detects damage, but anybody can compute one: so the contents are checked, too.
"""

from collections.abc import Iterator
from hashlib import sha256
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from marl_lanes.scenario.messages import shown
from marl_lanes.traffic.machine.state import (
    NONE,
    CollisionKind,
    Disposition,
    Fate,
    Outcome,
    Phase,
    State,
)
from marl_lanes.traffic.parameters import Parameters

_DIGEST_SIZE = sha256().digest_size

_MOST = 2**62
"""More than anything that is counted."""

_STAYS, _ABSENT, _UNFINISHED = int(Fate.STAYS), int(Phase.ABSENT), int(Outcome.UNFINISHED)


def take_snapshot(state: State, parameters: Parameters) -> bytes:
    """Every byte of the roads, after digests of the scenario's numbers and of these bytes."""
    content = state.tobytes()
    return _digest_parameters(parameters) + sha256(content).digest() + content


def read_snapshot(snapshot: bytes, state: State, parameters: Parameters) -> State:
    """The roads of a snapshot.

    Args:
        snapshot: of roads like those of ``state``, with the same scenario.
        state: gives shapes and dtypes; not changed.
        parameters: of the scenario.

    Returns:
        Arrays that cannot be written to.

    Raises:
        ValueError: it is of other roads, damaged, or of roads that cannot be.
    """
    if not isinstance(snapshot, bytes | bytearray | memoryview):
        raise ValueError(f"snapshot = {shown(snapshot)}: must be bytes")
    view = memoryview(snapshot).cast("B")
    wanted = 2 * _DIGEST_SIZE + sum(array.nbytes for array in state.arrays)
    if len(view) != wanted:
        raise ValueError(f"snapshot: {len(view)} bytes, must be {wanted}")
    scenario, digest = view[:_DIGEST_SIZE], view[_DIGEST_SIZE : 2 * _DIGEST_SIZE]
    content = view[2 * _DIGEST_SIZE :]
    if sha256(content).digest() != digest:
        raise ValueError("snapshot: is damaged, its digest does not fit")
    if scenario != _digest_parameters(parameters):
        raise ValueError("snapshot: is of another scenario")
    start, arrays = 0, []
    for array in state.arrays:
        stored = np.frombuffer(content, array.dtype, array.size, start)
        arrays.append(stored.reshape(array.shape))
        start += array.nbytes
    roads = State(*arrays)
    for check in chain(_check_fields(roads, parameters), _check_relations(roads, parameters)):
        _refuse(check)
    return roads


def _digest_parameters(parameters: Parameters) -> bytes:
    digest = sha256()
    for array in parameters.arrays:
        digest.update(repr((array.shape, array.dtype.descr)).encode() + array.tobytes())
    return digest.digest()


class _Check(NamedTuple):
    """Whether each element of a field is right, and what is allowed."""

    field: str
    is_right: NDArray[np.bool_]
    """(E, ...); its first axis is the road's index."""
    allowed: str


def _refuse(check: _Check) -> None:
    if not check.is_right.all():
        index = np.argwhere(~check.is_right)[0].tolist()
        raise ValueError(f"snapshot: {check.field}{index}: must be {check.allowed}")


def _check_fields(state: State, parameters: Parameters) -> Iterator[_Check]:
    """Every field by itself: finite numbers; indices, counts and codes in their ranges."""
    for table, records in vars(state).items():
        for name in records.dtype.names or ():
            values = records[name]
            if name == "command_position":
                yield _Check(f"{table}.{name}", ~np.isnan(values), "a number or infinite")
            elif values.dtype.kind == "f":
                yield _Check(f"{table}.{name}", np.isfinite(values), "finite")
    for table in ("observations", "follower_observations"):
        yield _Check(table, np.isfinite(getattr(state, table)), "finite")
    for field, (low, high) in _ranges(state, parameters).items():
        table, _, name = field.partition(".")
        values = getattr(state, table)
        values = values[name] if name else values
        yield _Check(field, (low <= values) & (values <= high), f"{low} to {high}")


def _ranges(state: State, parameters: Parameters) -> dict[str, tuple[int, int]]:
    """The smallest and the largest value of every index, count and code."""
    num_vehicles, num_slots = state.vehicles.shape[1], state.agents.shape[1]
    last_lane, last_vehicle = state.lanes.shape[1] - 1, num_vehicles - 1
    last_profile = len(parameters.profiles) - 1
    last_disposition = len(parameters.dispositions) - 1
    neighbors = ("leader", "follower", "target_leader", "target_follower")
    counters = [name for name in state.roads.dtype.names or () if name.startswith("num_")]
    return {
        **{f"roads.{name}": (0, _MOST) for name in ("step", *counters)},
        "roads.num_vehicles": (0, num_vehicles),
        "roads.num_commands": (0, int(parameters.constants[0]["num_agents"]) or _MOST),
        "roads.is_done": (0, 1),
        "roads.is_cut": (0, 1),
        "lanes.next_profile": (0, last_profile),
        "lanes.nearest": (NONE, last_vehicle),
        "lanes.nearest_engaged": (NONE, last_vehicle),
        "vehicles.id": (NONE, _MOST),
        "vehicles.lane": (0, last_lane),
        "vehicles.lane_low": (0, last_lane),
        "vehicles.lane_high": (0, last_lane),
        "vehicles.profile": (0, last_profile),
        "vehicles.disposition": (0, last_disposition),
        "vehicles.agent": (NONE, num_slots - 1),
        "vehicles.changer": (NONE, last_vehicle),
        "vehicles.fate": (0, int(max(Fate))),
        "vehicles.moving_over": (-1, 1),
        "order": (0, last_vehicle),
        **{f"agents.{name}": (NONE, last_vehicle) for name in ("vehicle", *neighbors)},
        "agents.command": (NONE, _MOST),
        "agents.num_aborts": (0, _MOST),
        "agents.born_step": (0, _MOST),
        "agents.steering_steps": (0, _MOST),
        "agents.phase": (0, int(max(Phase))),
        "agents.outcome": (0, int(max(Outcome))),
        "agents.direction": (-1, 1),
        "agents.origin_lane": (0, last_lane),
        "agents.target_lane": (0, last_lane),
        "followers.vehicle": (NONE, last_vehicle),
        "followers.policy": (NONE, last_disposition - int(Disposition.EXTERNAL)),
        "collisions.kind": (0, int(max(CollisionKind))),
    }


def _check_relations(state: State, parameters: Parameters) -> Iterator[_Check]:
    """What fields say about each other; every index is in its range."""
    roads, cars, agents, order = state.roads, state.vehicles, state.agents, state.order
    constants = parameters.constants[0]
    count = roads["num_vehicles"]
    is_there = cars["id"] != NONE
    is_removed = ~is_there & (cars["fate"] != _STAYS)
    is_live, has_ended = agents["phase"] != _ABSENT, agents["outcome"] != _UNFINISHED
    for name, flags in (
        ("num_vehicles", is_there),
        ("num_removed", is_removed),
        ("num_live", is_live),
        ("num_ended", has_ended),
    ):
        yield _Check(f"roads.{name}", roads[name] == flags.sum(axis=1), "what the tables hold")
    entered = count + roads["num_left"] + roads["num_collided"]
    yield _Check("roads.num_entered", roads["num_entered"] == entered, "as many as there were")
    horizon = constants["horizon_steps"]
    is_going_on = (roads["step"] < horizon) | (horizon == 0) | (roads["is_done"] == 1)
    yield _Check("roads.step", is_going_on, f"below {horizon} before the episode is over")
    is_listed = np.zeros_like(is_there)
    road, rank = np.nonzero(np.arange(order.shape[1]) < count[:, None])
    is_listed[road, order[road, rank]] = True
    yield _Check("order", (is_listed == is_there).all(axis=1), "every vehicle on the road, once")
    due = roads["step"] * constants["time_step"] + constants["interval_high"]
    is_soon = state.lanes["next_departure"] <= due[:, None] + constants["time_step"]
    yield _Check("lanes.next_departure", is_soon, "within the longest interval")
    yield from _check_vehicles(state, constants, is_there, is_live)
    yield from _check_agents(state, is_live, has_ended)


def _check_vehicles(
    state: State, constants: Any, is_there: NDArray[np.bool_], is_live: NDArray[np.bool_]
) -> Iterator[_Check]:
    """The vehicles on the road: where they are, and what they refer to."""
    cars, agents, gone = state.vehicles, state.agents, ~is_there
    width = constants["num_lanes"] * constants["lane_width"]
    road = np.arange(len(cars))[:, None]
    before = cars["lane"] - cars["moving_over"]
    commanded = np.where(is_live, agents["vehicle"], NONE)[road, cars["agent"]]
    for name, is_right, allowed in (
        ("fate", cars["fate"] == _STAYS, "that of a vehicle on the road"),
        ("id", cars["id"] < state.roads["num_entered"][:, None], "below num_entered"),
        ("speed", cars["speed"] >= 0.0, "at least 0"),
        ("position", _is_within(cars["position"], constants["road_length"]), "on the road"),
        ("lateral_position", _is_within(cars["lateral_position"], width), "on the road"),
        ("lane_low", cars["lane_low"] <= cars["lane_high"], "at most lane_high"),
        ("moving_over", _is_within(before, constants["num_lanes"] - 1), "from a lane of the road"),
        (
            "agent",
            (cars["agent"] == NONE) | (commanded == np.arange(cars.shape[1])),
            "the slot of its live command",
        ),
        (
            "changer",
            (cars["changer"] == NONE) | (cars["agent"][road, cars["changer"]] != NONE),
            "a vehicle with a command",
        ),
    ):
        yield _Check(f"vehicles.{name}", is_right | gone, allowed)


def _is_within(values: NDArray[Any], last: float) -> NDArray[np.bool_]:
    return np.asarray((values >= 0) & (values <= last))


def _check_agents(
    state: State, is_live: NDArray[np.bool_], has_ended: NDArray[np.bool_]
) -> Iterator[_Check]:
    """The live agents: their vehicles, lanes and serial numbers."""
    agents, cars = state.agents, state.vehicles
    road = np.arange(len(agents))[:, None]
    vehicle, direction = agents["vehicle"], agents["direction"]
    slots = np.arange(agents.shape[1])
    is_driven = (vehicle != NONE) & (cars["agent"][road, vehicle] == slots)
    is_driven &= cars["id"][road, vehicle] != NONE
    for name, is_right, allowed in (
        ("vehicle", is_driven, "a vehicle on the road with this command"),
        ("outcome", ~has_ended, "none while it is live"),
        ("direction", direction != 0, "-1 or 1"),
        ("target_lane", agents["target_lane"] == agents["origin_lane"] + direction, "beside"),
    ):
        yield _Check(f"agents.{name}", is_right | ~is_live, allowed)
    is_given = agents["command"] < state.roads["num_commands"][:, None]
    yield _Check("agents.command", is_given, "below num_commands")
    is_paid = (vehicle != NONE) | ~has_ended
    yield _Check("agents.vehicle", is_paid, "kept in the step that ends the command")
