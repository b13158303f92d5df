"""What the changers of a batch are told after a step, read out of their table in one pass.

Its records are longer than a cache line: one column costs as much to read as all of them.
"""

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from marl_lanes.traffic.machine.compiled import compiled, entry_point
from marl_lanes.traffic.machine.state import AGENT, Outcome, Phase, Records, structure

_ABSENT = int(Phase.ABSENT)
_ENGAGED = int(Phase.ENGAGED)
_ABORTING = int(Phase.ABORTING)
_UNFINISHED = int(Outcome.UNFINISHED)
_FIRST_TRUNCATING = int(Outcome.MISSED)


class Readout(NamedTuple):
    """New arrays, which are the caller's."""

    mask: NDArray[np.bool_]
    """(E, A): live."""
    engaged: NDArray[np.bool_]
    """(E, A): steering, engaged or aborting."""
    aborting: NDArray[np.bool_]
    """(E, A): steering back to the lane that it came from."""
    acting: NDArray[np.bool_]
    """(E, A): its action has an effect."""
    outcome: NDArray[np.int64]
    """(E, A) Outcome, set in the step that ended the command."""
    reward: NDArray[np.float32]
    """(E, A, 1), as the next four."""
    episode_reward: NDArray[np.float32]
    done: NDArray[np.bool_]
    """The command ended in the last step."""
    terminated: NDArray[np.bool_]
    """By completion, a collision or off the road."""
    truncated: NDArray[np.bool_]
    """Missed, or by the horizon."""


def read_out(agents: Records, *, acts_waiting: bool) -> Readout:
    """The columns of the changers.

    Args:
        agents: (E, A) AGENT.
        acts_waiting: whether a waiting changer acts, too.
    """
    flat, column = agents.shape, (*agents.shape, 1)
    readout = Readout(
        mask=np.empty(flat, np.bool_),
        engaged=np.empty(flat, np.bool_),
        aborting=np.empty(flat, np.bool_),
        acting=np.empty(flat, np.bool_),
        outcome=np.empty(flat, np.int64),
        reward=np.empty(column, np.float32),
        episode_reward=np.empty(column, np.float32),
        done=np.empty(column, np.bool_),
        terminated=np.empty(column, np.bool_),
        truncated=np.empty(column, np.bool_),
    )
    _kernel()(agents, acts_waiting, *readout)
    return readout


@cache
def _kernel() -> Callable[..., None]:
    """``_read`` for the types that it is always called with."""
    agents = np.empty((1, 1), structure(AGENT))
    flag, column = np.empty((1, 1), np.bool_), np.empty((1, 1, 1), np.bool_)
    outcome, number = np.empty((1, 1), np.int64), np.empty((1, 1, 1), np.float32)
    types = (flag, flag, flag, flag, outcome, number, number, column, column, column)
    return entry_point(_read, (agents, False, *types))


@compiled
def _read(
    agents: Any,
    acts_waiting: bool,
    mask: Any,
    engaged: Any,
    aborting: Any,
    acting: Any,
    outcome: Any,
    reward: Any,
    episode_reward: Any,
    done: Any,
    terminated: Any,
    truncated: Any,
) -> None:
    for env in range(agents.shape[0]):
        for slot in range(agents.shape[1]):
            agent = agents[env, slot]
            is_live, is_steering = agent.phase != _ABSENT, agent.phase >= _ENGAGED
            has_ended = agent.outcome != _UNFINISHED
            is_truncated = agent.outcome >= _FIRST_TRUNCATING
            mask[env, slot] = is_live
            engaged[env, slot] = is_steering
            aborting[env, slot] = agent.phase == _ABORTING
            acting[env, slot] = is_live if acts_waiting else is_steering
            outcome[env, slot] = agent.outcome
            reward[env, slot, 0] = agent.reward
            episode_reward[env, slot, 0] = agent.episode_reward
            done[env, slot, 0] = has_ended
            terminated[env, slot, 0] = has_ended and not is_truncated
            truncated[env, slot, 0] = is_truncated
