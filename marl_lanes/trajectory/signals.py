"""What a vehicle shows to others: whether it is commanded, indicators, brake lights, its loss."""

import numpy as np
from numpy.typing import NDArray

from marl_lanes.traffic.machine.state import Fate, Outcome, Phase
from marl_lanes.trajectory.frames import Rows

BRAKE_LIGHT = -0.5
"""[m/s^2] The brake lights are on at an acceleration below this."""


def are_commanded(rows: Rows) -> NDArray[np.bool_]:
    """(N,) Whether each vehicle has a command, or had one that ended in the step."""
    return np.asarray((rows["phase"] != Phase.ABSENT) | (rows["outcome"] != Outcome.UNFINISHED))


def are_braking(rows: Rows) -> NDArray[np.bool_]:
    """(N,) Whether the brake lights of each vehicle are on."""
    return np.asarray(rows["acceleration"] < BRAKE_LIGHT)


def are_lost(rows: Rows) -> NDArray[np.bool_]:
    """(N,) Whether the step removes each vehicle, other than at the road's end."""
    return np.asarray((rows["fate"] == Fate.COLLIDES) | (rows["fate"] == Fate.STRAYS))


def find_indicators(rows: Rows) -> NDArray[np.int8]:
    """(N,) The side on which each vehicle indicates: 1 left, -1 right, 0 none.

    A changer indicates to its target, and back to its lane while it aborts.
    """
    way = np.where(rows["phase"] == Phase.ABORTING, -rows["direction"], rows["direction"])
    return np.where(rows["phase"] != Phase.ABSENT, way, rows["moving_over"]).astype(np.int8)
