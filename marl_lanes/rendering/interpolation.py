"""A road between its time steps, so that a film can have more frames than there are steps."""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from marl_lanes.trajectory.frames import Frame

_SMOOTH = ("position", "lateral_position", "yaw", "speed")
"""Columns that are interpolated; the others are those of the step before."""


class Timeline:
    """The frames of a road as a function of time.

    Args:
        frames: of one road, ordered by time, at least one.
    """

    def __init__(self, frames: Sequence[Frame]) -> None:
        if not frames:
            raise ValueError("frames: must have at least one frame")
        self._frames = list(frames)
        self._steps = [frame.step for frame in frames]
        self._time_step = frames[0].scenario.time_step

    @property
    def start(self) -> float:
        """Time of the first frame [s]."""
        return self._frames[0].time

    @property
    def end(self) -> float:
        """Time of the last frame [s]."""
        return self._frames[-1].time

    def at(self, time: float) -> Frame:
        """The road at a time [s]; before the first frame that one, after the last frame the last.

        The motion between two steps is linear in the road's frame. A vehicle that a step removes
        stays where it is until the next step.
        """
        # A time that is meant to be a step's may differ from it by rounding.
        place = round(time / self._time_step, 6)
        index = max(0, bisect_right(self._steps, place) - 1)
        before = self._frames[index]
        if place <= before.step or index + 1 == len(self._frames):
            return before
        after = self._frames[index + 1]
        return _mix(before, after, (place - before.step) / (after.step - before.step))


def _mix(before: Frame, after: Frame, share: float) -> Frame:
    """The road at the given share of the way from one frame to the other."""
    _, here, there = np.intersect1d(
        before.rows["vehicle"], after.rows["vehicle"], assume_unique=True, return_indices=True
    )
    rows = before.rows.copy()
    for name in _SMOOTH:
        start, end = before.rows[name][here], after.rows[name][there]
        rows[name][here] = start + share * (end - start)
    return replace(before, rows=rows)
