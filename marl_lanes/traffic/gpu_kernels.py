"""The kernels of a GPU: the step of step.py compiled for CUDA, and what surrounds it there."""

import math
from typing import Any, cast

import numba
from numba import cuda

from marl_lanes.traffic.command.phases import is_acting
from marl_lanes.traffic.machine.launches import gpu_kernel
from marl_lanes.traffic.machine.state import NONE, Outcome
from marl_lanes.traffic.machine.team import MOST_MEMBERS
from marl_lanes.traffic.readout import read_changer, read_follower
from marl_lanes.traffic.step import run

_UNFINISHED = int(Outcome.UNFINISHED)

GROUPS_AT_WORK = 16
"""Groups of threads that one of a GPU's processors is to have at work at once, each a block.

That leaves 128 registers for each thread. Without a bound it takes more, and fewer are at work.
"""

_LIMITS: dict[str, Any] = {"launch_bounds": (MOST_MEMBERS, GROUPS_AT_WORK)}
if cast("Any", numba.config).ENABLE_CUDASIM:
    _LIMITS = {}

REFUSED, IS_FULL = 0, 1
"""What ``alarms`` holds: the number of a refused action, 1 for the first one of the changers and -1
for that of the followers; and whether a road is full."""


@gpu_kernel(**_LIMITS)
def advance(
    mode: int,
    num_steps: int,
    refused: Any,
    mask: Any,
    actions: Any,
    follower_actions: Any,
    roads: Any,
    lanes: Any,
    vehicles: Any,
    order: Any,
    agents: Any,
    followers: Any,
    collisions: Any,
    observations: Any,
    follower_observations: Any,
    constants: Any,
    profiles: Any,
    dispositions: Any,
    arcs: Any,
    features: Any,
    follower_features: Any,
) -> None:
    """``run`` with one road for each team of threads; nothing once an action was refused.

    A block's first dimension is a team, its second one counts the teams.

    Args:
        mode: and the next one, as for ``run``.
        num_steps: the most time steps of each road.
        refused: (1,) int64, 0 unless an action was refused.
        mask: this and all others, as for ``run``.
    """
    if refused[0] != 0:
        return
    first = cuda.blockIdx.x * cuda.blockDim.y + cuda.threadIdx.y
    for env in range(first, mask.shape[0], cuda.gridDim.x * cuda.blockDim.y):
        run(
            env,
            env + 1,
            mode,
            num_steps,
            mask,
            actions,
            follower_actions,
            roads,
            lanes,
            vehicles,
            order,
            agents,
            followers,
            collisions,
            observations,
            follower_observations,
            constants,
            profiles,
            dispositions,
            arcs,
            features,
            follower_features,
        )


@gpu_kernel()
def fill_rows(refused: Any, mask: Any, rows: Any, row: Any) -> None:
    """Set the masked rows of (E, n) to ``row``, (n,); nothing once an action was refused."""
    if refused[0] != 0:
        return
    size = row.shape[0]
    for index in range(cuda.grid(1), rows.shape[0] * size, cuda.gridsize(1)):
        if mask[index // size]:
            rows[index // size, index % size] = row[index % size]


@gpu_kernel()
def seed_roads(roads: Any, seed: int, first_road: int) -> None:
    """Restart the random numbers of every road; a road's stream is its index."""
    for env in range(cuda.grid(1), roads.shape[0], cuda.gridsize(1)):
        roads[env].random_key = seed
        roads[env].random_stream = first_road + env
        roads[env].random_counter = 0


@gpu_kernel()
def look_for_full_roads(mask: Any, roads: Any, alarms: Any) -> None:
    """Raise an alarm if departures waited because ``max_vehicles`` were on a masked road."""
    for env in range(cuda.grid(1), roads.shape[0], cuda.gridsize(1)):
        if mask[env] and roads[env].num_held_back > 0:
            alarms[IS_FULL] = 1


@gpu_kernel()
def copy_numbers(given: Any, kept: Any) -> None:
    """Set ``kept``, (E, A, D) float64, to ``given``, which may be of another layout and type."""
    num_slots, size = kept.shape[1], kept.shape[2]
    for index in range(cuda.grid(1), kept.size, cuda.gridsize(1)):
        column, row = index % size, index // size
        kept[row // num_slots, row % num_slots, column] = given[
            row // num_slots, row % num_slots, column
        ]


@cuda.jit(device=True)
def _refuse(number: int, refused: Any, alarms: Any) -> None:
    """Keep one number of all threads."""
    if cuda.atomic.cas(refused, 0, 0, number) == 0:
        alarms[REFUSED] = number


@gpu_kernel()
def check_actions(
    actions: Any, agents: Any, has_longitudinal: bool, refused: Any, alarms: Any
) -> None:
    """Set actions that are not finite to 0, and refuse that of an acting changer.

    Args:
        actions: (E, A, D) float64.
        agents: (E, A) AGENT.
        has_longitudinal: as for ``read_masks``.
        refused: (1,) int64, on the GPU: set to the number of a refused action.
        alarms: (2,) int64, in the computer's memory: the same.
    """
    num_slots, size = actions.shape[1], actions.shape[2]
    for index in range(cuda.grid(1), actions.size, cuda.gridsize(1)):
        column, row = index % size, index // size
        env, slot = row // num_slots, row % num_slots
        if not math.isfinite(actions[env, slot, column]):
            actions[env, slot, column] = 0.0
            if is_acting(agents[env, slot], has_longitudinal):
                _refuse(index + 1, refused, alarms)


@gpu_kernel()
def check_follower_actions(
    actions: Any, followers: Any, policy: int, refused: Any, alarms: Any
) -> None:
    """``check_actions`` for (E, A, 1) actions of the followers that ``policy`` drives."""
    num_slots = actions.shape[1]
    for index in range(cuda.grid(1), actions.size, cuda.gridsize(1)):
        env, slot = index // num_slots, index % num_slots
        if not math.isfinite(actions[env, slot, 0]):
            actions[env, slot, 0] = 0.0
            if followers[env, slot].policy == policy:
                _refuse(-index - 1, refused, alarms)


@gpu_kernel()
def read_changers(
    agents: Any,
    has_longitudinal: bool,
    mask: Any,
    steering: Any,
    aborting: Any,
    acting: Any,
    outcome: Any,
    reward: Any,
    command_reward: Any,
    done: Any,
    terminated: Any,
    truncated: Any,
    roads: Any,
    road_done: Any,
    road_terminated: Any,
    road_truncated: Any,
) -> None:
    """The columns of ``readout.read_changers``, and the ends of the roads, (E, 1) bool."""
    num_slots = agents.shape[1]
    for index in range(cuda.grid(1), agents.size, cuda.gridsize(1)):
        env, slot = index // num_slots, index % num_slots
        read_changer(
            env,
            slot,
            agents,
            has_longitudinal,
            mask,
            steering,
            aborting,
            acting,
            outcome,
            reward,
            command_reward,
            done,
            terminated,
            truncated,
        )
        if slot == 0:
            is_done, is_cut = roads[env].is_done != 0, roads[env].is_cut != 0
            road_done[env, 0] = is_done
            road_terminated[env, 0] = is_done and not is_cut
            road_truncated[env, 0] = is_cut


@gpu_kernel()
def read_followers(
    agents: Any,
    followers: Any,
    policy: int,
    mask: Any,
    acting: Any,
    reward: Any,
    command_reward: Any,
    done: Any,
    terminated: Any,
    truncated: Any,
) -> None:
    """The columns of ``readout.read_followers``."""
    num_slots = agents.shape[1]
    for index in range(cuda.grid(1), agents.size, cuda.gridsize(1)):
        read_follower(
            index // num_slots,
            index % num_slots,
            agents,
            followers,
            policy,
            mask,
            acting,
            reward,
            command_reward,
            done,
            terminated,
            truncated,
        )


@gpu_kernel()
def read_vehicles(
    roads: Any, order: Any, vehicles: Any, agents: Any, profiles: Any, rows: Any
) -> None:
    """Every vehicle by decreasing position, (E, V, 7) float32 or, with length and width, 9.

    The columns are those of ``state_columns``.
    """
    num_vehicles = order.shape[1]
    for index in range(cuda.grid(1), order.size, cuda.gridsize(1)):
        env, rank = index // num_vehicles, index % num_vehicles
        row = rows[env, rank]
        if rank >= roads[env].num_vehicles:
            for column in range(rows.shape[2] - 1):
                row[column] = 0.0
            row[rows.shape[2] - 1] = NONE
            continue
        place = order[env, rank]
        car = vehicles[env, place]
        row[0] = car.position
        row[1] = car.lateral_position
        row[2] = car.speed
        row[3] = car.acceleration
        row[4] = car.yaw
        row[5] = car.yaw_rate
        if rows.shape[2] > 7:
            row[6] = 2.0 * profiles[car.profile].half_length
            row[7] = 2.0 * profiles[car.profile].half_width
        slot = car.agent
        if roads[env].num_ended > 0:
            for other in range(agents.shape[1]):
                agent = agents[env, other]
                if agent.outcome != _UNFINISHED and agent.vehicle == place:
                    slot = other
        row[rows.shape[2] - 1] = slot
