"""Actions of PettingZoo's agents: read in any shape of the right size, and scaled."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from marl_lanes.scenario.messages import shown
from marl_lanes.traffic.arguments import read_numbers


def check_actions(actions: object) -> None:
    """Refuse what is no mapping of agents to actions.

    Raises:
        ValueError: it is none.
    """
    if not isinstance(actions, Mapping):
        raise ValueError(f"actions = {shown(actions)}: must be a mapping of agents to actions")


def read_action(agent: str, action: Any, size: int) -> NDArray[np.floating[Any]]:
    """An agent's action as a vector.

    Args:
        agent: for the message.
        action: ``size`` finite numbers in any shape: learners squeeze an action of one dimension to
            a number, or leave it in a batch of one; a tensor may require a gradient.
        size: D.

    Returns:
        (D,) floats.

    Raises:
        ValueError: it is something else.
    """
    name, shape = f"actions[{agent!r}]", (size,)
    # The common case first, as it is read at every step.
    if type(action) is not np.ndarray or action.shape != shape:
        action = _reshape(action, shape)
    values = read_numbers(name, action, shape)
    if not np.isfinite(values).all():
        raise ValueError(f"{name} = {values.tolist()}: must be finite [rad/s^2, m/s^2]")
    return values


def _reshape(action: Any, shape: tuple[int, ...]) -> Any:
    """The action in the shape where that is possible; what is wrong is left as it is."""
    if hasattr(action, "detach"):
        action = action.detach()
        if str(action.dtype) == "torch.bfloat16":
            # numpy has no such numbers; these are as exact.
            action = action.float()
    if isinstance(action, np.ma.MaskedArray):
        return action
    try:
        array = np.asarray(action)
    except (TypeError, ValueError, RuntimeError, OverflowError):
        return action
    return array.reshape(shape) if array.size == math.prod(shape) else array


def scale_action(action: Any, low: Any, high: Any) -> Any:
    """The action whose part of its bound is given: -1 is the lower one, 0 is 0, 1 the upper one.

    Args:
        action: (..., D) array or tensor; beyond [-1, 1] it is beyond the bounds.
        low: (D,), negative, of the same kind.
        high: (D,), positive.

    Returns:
        (..., D), of the same kind.
    """
    return action.clip(min=0.0) * high - action.clip(max=0.0) * low
