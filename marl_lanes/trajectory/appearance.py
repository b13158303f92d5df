"""What a vehicle shows, in every picture and export: command, loss, brake lights, indicator."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from marl_lanes.traffic.machine.state import Fate, Outcome, Phase
from marl_lanes.trajectory.frames import Rows

BRAKE_LIGHT = -0.5
"""[m/s^2] The brake lights are on at an acceleration below this."""


def is_commanded(rows: Rows) -> NDArray[np.bool_]:
    """Whether vehicles have a command, or had one that ended in this step.

    Args:
        rows: (N,) ROW.

    Returns:
        (N,) bool.
    """
    return np.asarray((rows["phase"] != Phase.ABSENT) | (rows["outcome"] != Outcome.UNFINISHED))


def is_lost(rows: Rows) -> NDArray[np.bool_]:
    """Whether vehicles collided or left the road in this step, which removes them.

    Args:
        rows: (N,) ROW.

    Returns:
        (N,) bool.
    """
    return np.asarray((rows["fate"] == Fate.COLLIDES) | (rows["fate"] == Fate.STRAYS))


def is_braking(rows: Rows) -> NDArray[np.bool_]:
    """Whether the brake lights are on.

    Args:
        rows: (N,) ROW.

    Returns:
        (N,) bool.
    """
    return np.asarray(rows["acceleration"] < BRAKE_LIGHT)


def indicated_side(rows: Rows) -> NDArray[np.integer[Any]]:
    """The side on which the indicator blinks.

    A changer indicates the side of its target lane, while it aborts the side of its way back, and
    nothing once its command has ended. Another vehicle indicates the side to which it moves over.

    Args:
        rows: (N,) ROW.

    Returns:
        (N,) int: 1 left, -1 right, 0 none.
    """
    way = np.where(rows["phase"] == Phase.ABORTING, -rows["direction"], rows["direction"])
    is_live = rows["outcome"] == Outcome.UNFINISHED
    return np.where(is_commanded(rows), way * is_live, rows["moving_over"])
