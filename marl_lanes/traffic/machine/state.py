"""The state: name, dtype, unit and meaning of every array in one place, and its allocation.

Axes: E environments (roads), V vehicle slots, A agent slots, L lanes, C collision records, F
features of an agent, G features of a follower, T terms of a role's reward. Follower k belongs to
agent slot k.
An array of structures: ``state.vehicles[e, i].speed`` in a kernel, ``state.vehicles["speed"]``
(E, V) outside it.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

NONE = -1
"""No vehicle, no agent: the value of an index without a target.

Before an index is used, test it with ``> NONE``: this also tells the compiler that it is not
negative, so the code for numpy's negative indices is left out.
"""


class Phase(IntEnum):
    """Phase of an agent's command."""

    ABSENT = 0
    WAITING = 1
    ENGAGED = 2
    ABORTING = 3


class Outcome(IntEnum):
    """How a command ended; UNFINISHED before. MISSED and all after it truncate."""

    UNFINISHED = 0
    COMPLETED = 1
    COLLISION = 2
    OFF_ROAD = 3
    MISSED = 4
    HORIZON = 5
    TIMED_OUT = 6


def truncates(outcome: int) -> bool:
    """Whether the outcome is a truncation: the road or a time has ended, not the task."""
    return outcome >= _FIRST_TRUNCATING


_FIRST_TRUNCATING = int(Outcome.MISSED)


class CollisionKind(IntEnum):
    """How two bodies collided."""

    REAR_END = 0
    SIDE = 1


class Fate(IntEnum):
    """What a step does with a vehicle."""

    STAYS = 0
    LEAVES = 1
    """At the road's end."""
    COLLIDES = 2
    STRAYS = 3
    """Over an edge of the road, or with |yaw| of 90 degrees or more."""


class Disposition(IntEnum):
    """What a driver does behind an engaged changer in its target lane."""

    COOPERATIVE = 0
    NEUTRAL = 1
    ADVERSARIAL = 2
    EXTERNAL = 3
    """EXTERNAL + i: the i-th disposition of the mix that a policy drives."""


Table = tuple[tuple[str, str, str, str], ...]
"""Rows of name, dtype, unit, meaning; the dtype ``(T,)f8`` holds one value for each term."""

VEHICLE: Table = (
    ("position", "f8", "m", "centre, along the road's right edge"),
    ("lateral_position", "f8", "m", "centre, from the road's right edge, positive to the left"),
    ("speed", "f8", "m/s", "along the vehicle's heading"),
    ("acceleration", "f8", "m/s^2", "longitudinal, applied in the last step: dv/dt"),
    ("yaw", "f8", "rad", "heading relative to the road, positive to the left"),
    ("yaw_rate", "f8", "rad/s", "turning of the heading, the road's own turning included"),
    ("yaw_acceleration", "f8", "rad/s^2", "applied in the last step: change of yaw_rate/dt"),
    ("desired_speed", "f8", "m/s", "v0 of the car-following law"),
    ("command_position", "f8", "m", "where it may be commanded; inf once that is decided"),
    ("advance", "f8", "m", "change of position in the last step"),
    ("id", "i8", "1", "serial number on this road; -1 where the slot is empty"),
    (
        "moving_over",
        "i8",
        "1",
        "while it moves over: +1 to the left, -1 to the right; else 0",
    ),
    ("lane", "i4", "lane", "the lane that it keeps"),
    ("lane_low", "i4", "lane", "right-most lane that its body overlaps"),
    ("lane_high", "i4", "lane", "left-most lane that its body overlaps"),
    ("profile", "u4", "1", "row of the driver profiles"),
    ("disposition", "i4", "1", "Disposition, or EXTERNAL + i"),
    ("agent", "i4", "1", "agent slot, -1 where it has no live command"),
    ("changer", "i4", "1", "vehicle slot of the engaged changer whose follower it is, or -1"),
    ("fate", "i4", "1", "Fate in the last step"),
)

AGENT: Table = (
    ("command", "i8", "1", "serial number of the command in the episode, from 0; -1 at first"),
    ("num_aborts", "i8", "1", "number of aborts"),
    ("born_step", "i8", "step", "step of the command"),
    ("steering_steps", "i8", "step", "steps that it steered"),
    ("reward", "f8", "1", "of the last step: the sum of the terms"),
    ("episode_reward", "f8", "1", "sum of the rewards since the command"),
    ("car_following", "f8", "m/s^2", "acceleration of car following in the last step"),
    ("terms", "(T,)f8", "1", "of the reward of the last step, TERMS of roles/changer.py"),
    (
        "vehicle",
        "i4",
        "1",
        "vehicle slot, -1 if this slot is free; kept in the step that ends the command",
    ),
    ("phase", "i4", "1", "Phase"),
    ("outcome", "i4", "1", "Outcome, set only in the step that ends the command"),
    ("direction", "i4", "1", "+1 to the left, -1 to the right"),
    ("origin_lane", "i4", "lane", "the lane of the command"),
    ("target_lane", "i4", "lane", "the lane to reach"),
    ("leader", "i4", "1", "vehicle slot ahead in the origin lane, -1 if none"),
    ("follower", "i4", "1", "vehicle slot behind in the origin lane, -1 if none"),
    ("target_leader", "i4", "1", "vehicle slot ahead in the target lane, -1 if none"),
    ("target_follower", "i4", "1", "vehicle slot behind in the target lane, -1 if none"),
)

FOLLOWER: Table = (
    ("reward", "f8", "1", "of the last step: the sum of the terms"),
    ("episode_reward", "f8", "1", "sum of the rewards since the command"),
    ("terms", "(T,)f8", "1", "of the reward of the last step, TERMS of roles/follower.py"),
    ("vehicle", "i4", "1", "vehicle slot of the external driver paired with the changer, or -1"),
    ("policy", "i4", "1", "index of its external disposition, disposition - EXTERNAL; or -1"),
)

ROAD: Table = (
    ("random_key", "u8", "1", "seed of the random numbers"),
    ("random_stream", "u8", "1", "stream of the random numbers: the road's index"),
    ("random_counter", "u8", "1", "random numbers drawn so far"),
    ("step", "i8", "step", "steps since the warm-up ended; negative before"),
    ("num_vehicles", "i8", "1", "on the road"),
    ("num_entered", "i8", "1", "vehicles that entered since the reset"),
    (
        "num_held_back",
        "i8",
        "1",
        "steps that due vehicles waited because max_vehicles were on the road, over all lanes",
    ),
    ("num_left", "i8", "1", "vehicles that left at the road's end, or off the road"),
    ("num_off_road", "i8", "1", "those of num_left that left off the road"),
    ("num_collided", "i8", "1", "vehicles removed by a collision"),
    ("num_removed", "i8", "1", "vehicles removed in the last step, whose slots are not free yet"),
    ("num_collisions", "i8", "1", "collisions recorded since the reset"),
    ("num_moves_over", "i8", "1", "moves over that followers began since the reset"),
    ("num_moves_returned", "i8", "1", "those of num_moves_over that were taken back"),
    ("num_commands", "i8", "1", "commands given in this episode"),
    ("num_live", "i8", "1", "agents live now"),
    ("num_ended", "i8", "1", "commands that ended in the last step, whose slots are not free yet"),
    ("is_done", "i8", "1", "1 once the episode is over"),
    ("is_cut", "i8", "1", "1 if the horizon ended it before all commands were given and had ended"),
)

LANE: Table = (
    ("next_departure", "f8", "s", "time of the next departure, since the warm-up"),
    ("next_speed", "f8", "m/s", "speed of the next departure"),
    ("next_profile", "i8", "1", "driver profile of the next departure"),
    (
        "nearest",
        "i4",
        "1",
        "in the sweep over the vehicles: last slot seen in the lane, -1 if none",
    ),
    ("nearest_engaged", "i4", "1", "the same, of those engaged or moving over toward the lane"),
)

COLLISION: Table = (
    ("step", "i8", "step", "step of the collision; the record is empty if rear_id is -1"),
    ("rear_id", "i8", "1", "id of the vehicle behind"),
    ("front_id", "i8", "1", "id of the vehicle ahead"),
    ("rear_command", "i8", "1", "command of the vehicle behind, -1 if none was live"),
    ("front_command", "i8", "1", "command of the vehicle ahead, -1 if none was live"),
    ("kind", "i8", "1", "CollisionKind"),
    ("position", "f8", "m", "of the vehicle behind"),
    ("closing_speed", "f8", "m/s", "speed of the one behind minus that of the one ahead"),
)

NUM_COLLISION_RECORDS = 16
"""C: a road keeps the records of its C newest collisions; the counters count all."""

Records = NDArray[np.void]


def structure(table: Table, *, num_terms: int = 0) -> np.dtype[np.void]:
    """The aligned structured dtype of a table, its fields readable as attributes."""
    kinds = [(name, kind.replace("T", str(num_terms))) for name, kind, _, _ in table]
    fields = np.dtype(kinds, align=True)
    # Padding bytes are never set, so equal states could differ in them.
    if fields.itemsize != sum(np.dtype(kind).itemsize for _, kind in kinds):
        raise ValueError("8-byte fields must come first; the number of 4-byte fields must be even")
    # A record dtype gives attribute access in compiled and in interpreted kernels alike.
    return np.dtype((np.record, fields))


@dataclass(frozen=True)
class State:
    """The arrays of E roads, in the order in which every kernel takes them."""

    roads: Records
    """(E,) ROAD."""
    lanes: Records
    """(E, L) LANE."""
    vehicles: Records
    """(E, V) VEHICLE."""
    order: NDArray[np.uint32]
    """(E, V) vehicle slots by decreasing position; the first num_vehicles count."""
    agents: Records
    """(E, A) AGENT."""
    followers: Records
    """(E, A) FOLLOWER, only for external drivers."""
    collisions: Records
    """(E, C) COLLISION, a ring buffer indexed by num_collisions."""
    observations: NDArray[np.float32]
    """(E, A, F) features of the live agents; for an agent that just ended, its last ones."""
    follower_observations: NDArray[np.float32]
    """(E, A, G) observations of the live agents' target followers."""

    @property
    def arrays(self) -> tuple[NDArray[np.generic], ...]:
        """The arrays in kernel order."""
        return (
            self.roads,
            self.lanes,
            self.vehicles,
            self.order,
            self.agents,
            self.followers,
            self.collisions,
            self.observations,
            self.follower_observations,
        )

    def tobytes(self) -> bytes:
        """Every byte of the state, for comparisons."""
        return b"".join(array.tobytes() for array in self.arrays)


def allocate(
    *,
    num_envs: int,
    num_lanes: int,
    max_vehicles: int,
    num_slots: int,
    num_features: int,
    num_terms: int,
    num_follower_features: int,
    num_follower_terms: int,
) -> State:
    """An empty state of E roads."""
    vehicles = np.zeros((num_envs, max_vehicles), structure(VEHICLE))
    agents = np.zeros((num_envs, num_slots), structure(AGENT, num_terms=num_terms))
    followers = np.zeros((num_envs, num_slots), structure(FOLLOWER, num_terms=num_follower_terms))
    collisions = np.zeros((num_envs, NUM_COLLISION_RECORDS), structure(COLLISION))
    vehicles["id"] = vehicles["agent"] = agents["vehicle"] = NONE
    agents["command"] = followers["vehicle"] = followers["policy"] = NONE
    collisions["rear_id"] = collisions["front_id"] = NONE
    roads = np.zeros(num_envs, structure(ROAD))
    return State(
        roads=roads,
        lanes=np.zeros((num_envs, num_lanes), structure(LANE)),
        vehicles=vehicles,
        order=np.zeros((num_envs, max_vehicles), np.uint32),
        agents=agents,
        followers=followers,
        collisions=collisions,
        observations=np.zeros((num_envs, num_slots, num_features), np.float32),
        follower_observations=np.zeros((num_envs, num_slots, num_follower_features), np.float32),
    )
