"""Masks, outcomes and rewards of a batch after a step, read from each table in one pass.

A record is longer than a cache line, so reading one column takes as long as reading all.
"""

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from marl_lanes.traffic.command.phases import is_aborting, is_acting, is_live, is_steering
from marl_lanes.traffic.machine.compiled import compiled, entry_point, internal
from marl_lanes.traffic.machine.state import Outcome, Records, truncates
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.traffic.roles.follower import FOLLOWER

_UNFINISHED = int(Outcome.UNFINISHED)

Columns = dict[str, NDArray[Any]]
"""New arrays, owned by the caller, by their keys in TorchRL."""


class Masks(NamedTuple):
    """The state of the changers' slots, (E, A) bool each."""

    live: NDArray[np.bool_]
    """The command is unfinished."""
    steering: NDArray[np.bool_]
    """The agent steers: it is engaged or aborting."""
    acting: NDArray[np.bool_]
    """Its action has an effect."""


def read_masks(agents: Records, *, has_longitudinal: bool) -> Masks:
    """The state of every slot.

    Args:
        agents: (E, A) AGENT.
        has_longitudinal: whether the action has a second dimension; then a waiting changer acts,
            too.
    """
    masks = Masks(*(np.empty(agents.shape, np.bool_) for _ in Masks._fields))
    _masks_kernel()(agents, has_longitudinal, *masks)
    return masks


def read_changers(agents: Records, *, has_longitudinal: bool) -> Columns:
    """Masks, outcomes, rewards and ends of the changers.

    Args:
        agents: (E, A) AGENT.
        has_longitudinal: as for ``read_masks``.

    Returns:
        ``mask`` (live), ``steering``, ``aborting`` and ``acting``, (E, A) bool; ``outcome``, (E, A)
        int64, set in the step that ends a command; ``reward`` and ``command_reward``, (E, A, 1)
        float32; ``done``, ``terminated`` and ``truncated``, (E, A, 1) bool.
    """
    columns = changer_columns(agents.shape)
    _changers_kernel()(agents, has_longitudinal, *columns.values())
    return columns


def read_followers(agents: Records, followers: Records, *, policy: int) -> Columns:
    """Masks, rewards and ends of the learned followers, which end with their changers.

    Args:
        agents: (E, A) AGENT.
        followers: (E, A) FOLLOWER.
        policy: ``policy`` of the followers that a learner drives.

    Returns:
        As ``read_changers``, without ``steering``, ``aborting`` and ``outcome``.
    """
    columns = follower_columns(agents.shape)
    _followers_kernel()(agents, followers, policy, *columns.values())
    return columns


def changer_columns(flat: tuple[int, ...], empty: Callable[..., Any] = np.empty) -> Columns:
    """Arrays for ``read_changers``, in the kernel's order.

    Args:
        flat: (E, A).
        empty: makes an array of a shape and a dtype.
    """
    return {
        "mask": empty(flat, np.bool_),
        "steering": empty(flat, np.bool_),
        "aborting": empty(flat, np.bool_),
        "acting": empty(flat, np.bool_),
        "outcome": empty(flat, np.int64),
        **_common(flat, empty),
    }


def follower_columns(flat: tuple[int, ...], empty: Callable[..., Any] = np.empty) -> Columns:
    """Arrays for ``read_followers``; the arguments are those of ``changer_columns``."""
    return {
        "mask": empty(flat, np.bool_),
        "acting": empty(flat, np.bool_),
        **_common(flat, empty),
    }


def _common(flat: tuple[int, ...], empty: Callable[..., Any]) -> Columns:
    return {
        "reward": empty((*flat, 1), np.float32),
        "command_reward": empty((*flat, 1), np.float32),
        "done": empty((*flat, 1), np.bool_),
        "terminated": empty((*flat, 1), np.bool_),
        "truncated": empty((*flat, 1), np.bool_),
    }


_FLAG = np.empty((1, 1), np.bool_)


@cache
def _masks_kernel() -> Callable[..., None]:
    """The kernel, compiled for the types of all its calls; so are the next two."""
    return entry_point(_read_masks, (np.empty((1, 1), CHANGER.dtype), False, *[_FLAG] * 3))


@cache
def _changers_kernel() -> Callable[..., None]:
    agents = np.empty((1, 1), CHANGER.dtype)
    types = changer_columns((1, 1)).values()
    return entry_point(_read_changers, (agents, False, *types))


@cache
def _followers_kernel() -> Callable[..., None]:
    agents, followers = (np.empty((1, 1), role.dtype) for role in (CHANGER, FOLLOWER))
    types = follower_columns((1, 1)).values()
    return entry_point(_read_followers, (agents, followers, 0, *types))


_truncates = internal(truncates)


@compiled
def _read_masks(agents: Any, has_longitudinal: bool, live: Any, steering: Any, acting: Any) -> None:
    for env in range(agents.shape[0]):
        for slot in range(agents.shape[1]):
            agent = agents[env, slot]
            live[env, slot] = is_live(agent)
            steering[env, slot] = is_steering(agent)
            acting[env, slot] = is_acting(agent, has_longitudinal)


@internal
def _read_end(agent: Any, done: Any, terminated: Any, truncated: Any) -> None:
    """Set the ends, each (1,); they are true only in the step that ends the command."""
    has_ended = agent.outcome != _UNFINISHED
    is_truncated = _truncates(agent.outcome)
    done[0] = has_ended
    terminated[0] = has_ended and not is_truncated
    truncated[0] = is_truncated


@internal
def read_changer(
    env: int,
    slot: int,
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
) -> None:
    """Set the elements of one slot in the columns of ``read_changers``."""
    agent = agents[env, slot]
    mask[env, slot] = is_live(agent)
    steering[env, slot] = is_steering(agent)
    aborting[env, slot] = is_aborting(agent)
    acting[env, slot] = is_acting(agent, has_longitudinal)
    outcome[env, slot] = agent.outcome
    reward[env, slot, 0] = agent.reward
    command_reward[env, slot, 0] = agent.episode_reward
    _read_end(agent, done[env, slot], terminated[env, slot], truncated[env, slot])


@internal
def read_follower(
    env: int,
    slot: int,
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
    """Set the elements of one slot in the columns of ``read_followers``."""
    agent, follower = agents[env, slot], followers[env, slot]
    mask[env, slot] = is_live(agent)
    acting[env, slot] = follower.policy == policy
    reward[env, slot, 0] = follower.reward
    command_reward[env, slot, 0] = follower.episode_reward
    _read_end(agent, done[env, slot], terminated[env, slot], truncated[env, slot])


@compiled
def _read_changers(
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
) -> None:
    for env in range(agents.shape[0]):
        for slot in range(agents.shape[1]):
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


@compiled
def _read_followers(
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
    for env in range(agents.shape[0]):
        for slot in range(agents.shape[1]):
            read_follower(
                env,
                slot,
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
