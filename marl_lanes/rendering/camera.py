"""The camera: from places on the road to pixels, and from pixels to places on the road."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from marl_lanes.scenario import Scenario
from marl_lanes.trajectory.road_line import RoadLine

FloatArray = NDArray[np.floating[Any]]

BEHIND = 0.42
"""Share of the picture's width that lies behind the followed vehicle."""

MARGIN = 5.5
"""[m] Least strip of ground beside the road."""

CELL = 16
"""[pixel] Between the points at which places on the road are computed; linear in between."""

_SPACING = 16.0
"""[pixel] Between the points of the road of which the nearest is sought."""

_STRAIGHT = 1e-6
"""[rad] A road that turns less within the picture is straight."""


class Camera:
    """Looks down on the road, the same scale in both directions.

    The road's heading at the looked-at position points to the right, and the road's middle is at
    the middle of the height there.

    Args:
        scenario: of the road.
        size: width and height of the picture [pixel].
        span: length of road to show [m].
    """

    def __init__(self, scenario: Scenario, size: tuple[int, int], span: float) -> None:
        self.size = size
        self.road_width = scenario.road.num_lanes * scenario.road.lane_width
        self.scale = min(size[0] / span, size[1] / (self.road_width + 2.0 * MARGIN))
        """[pixel/m]"""
        self._line = RoadLine(scenario)
        self._is_curved = bool(scenario.road.arcs)
        self.reach = (0.0, 0.0)
        """Positions between which the road may be in the picture [m]."""
        self.look_at(0.0)

    @property
    def start(self) -> float:
        """Position at the left edge, along a straight road [m]."""
        return self.position - BEHIND * self.size[0] / self.scale

    @property
    def end(self) -> float:
        """Position at the right edge, along a straight road [m]."""
        return self.start + self.size[0] / self.scale

    def look_at(self, position: float) -> None:
        """Move to a position along the road [m]."""
        self.position = position
        x, y, heading = self._line.place(position, 0.5 * self.road_width)
        self._x, self._y, self._heading = float(x), float(y), float(heading)
        reach = max(0.5 * self.size[0], self.size[1]) / self.scale
        self.reach = (
            max(self.start - reach, float(self._line.position[0])),
            min(self.end + reach, float(self._line.position[-1])),
        )
        self._samples = np.arange(*self.reach, _SPACING / self.scale)
        if self._is_curved:
            headings = self._line.place(self._samples, np.zeros_like(self._samples))[2]
            self._is_straight = bool(np.ptp(headings) < _STRAIGHT)
        else:
            self._is_straight = True

    def place(
        self, position: ArrayLike, lateral_position: ArrayLike
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Pixels x (right) and y (down), and the road's heading in the picture [rad, left]."""
        along = np.asarray(position, np.float64)
        across = np.broadcast_to(np.asarray(lateral_position, np.float64), along.shape)
        x, y, heading = self._line.place(along, across)
        cosine, sine = math.cos(self._heading), math.sin(self._heading)
        ahead = (x - self._x) * cosine + (y - self._y) * sine
        left = (y - self._y) * cosine - (x - self._x) * sine
        column = BEHIND * self.size[0] + self.scale * ahead
        return column, 0.5 * self.size[1] - self.scale * left, heading - self._heading

    def look_up(self) -> tuple[FloatArray, FloatArray]:
        """Position and lateral position [m] of pixels, as grids that ``spread`` takes.

        Both broadcast to (rows, columns). Where the road in the picture is straight, they are those
        of the pixels' middles, (1, width) and (height, 1); else those of a coarse grid.
        """
        width, height = self.size
        if self._is_straight:
            along, across = self._to_plane(np.arange(width) + 0.5, np.arange(height) + 0.5)
            return (self.position + along)[None], (0.5 * self.road_width + across)[:, None]
        return self._find_nearest(*self._to_plane(_points(width), _points(height)))

    def spread(self, *grids: FloatArray) -> Iterator[tuple[slice, list[FloatArray]]]:
        """Values at the pixels' middles, from grids of ``look_up`` or functions of them.

        Yields:
            bands of the picture from the top: rows of pixels, and for each grid float32 that
            broadcasts to (rows, width). One band where the road in the picture is straight; else
            bands so small that they stay in the processor's cache.
        """
        width, height = self.size
        single = [grid.astype(np.float32) for grid in grids]
        if self._is_straight:
            yield slice(0, height), single
            return
        for index, top in enumerate(range(0, height, CELL)):
            count = min(CELL, height - top)
            pairs = (grid[index : index + 2].T for grid in single)
            bands = [_spread_columns(_spread_columns(pair)[:, :count].T) for pair in pairs]
            yield slice(top, top + count), [band[:, :width] for band in bands]

    def _to_plane(self, columns: FloatArray, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Metres ahead of and to the left of the looked-at point."""
        ahead = (columns - BEHIND * self.size[0]) / self.scale
        return ahead, (0.5 * self.size[1] - rows) / self.scale

    def _find_nearest(self, ahead: FloatArray, left: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Places on the road of the points of a grid, each (rows, columns)."""
        column, row, heading = self.place(self._samples, 0.5 * self.road_width)
        line_ahead, line_left = self._to_plane(column, row)
        shape = (left.size, ahead.size)
        grid_ahead = np.broadcast_to(ahead[None], shape).ravel()
        grid_left = np.broadcast_to(left[:, None], shape).ravel()
        # |p - q|^2 without |p|^2, as one product of matrices.
        distance = 0.5 * (line_ahead**2 + line_left**2) - (
            np.stack([grid_ahead, grid_left], axis=1) @ np.stack([line_ahead, line_left])
        )
        nearest = np.argmin(distance, axis=1)
        from_ahead = grid_ahead - line_ahead[nearest]
        from_left = grid_left - line_left[nearest]
        cosine, sine = np.cos(heading[nearest]), np.sin(heading[nearest])
        along = from_ahead * cosine + from_left * sine
        across = from_left * cosine - from_ahead * sine
        curvature = np.gradient(heading, self._samples)[nearest]
        lateral_position = 0.5 * self.road_width + across
        # On the inside of a curve a metre along the edge is less than a metre on the ground.
        position = self._samples[nearest] + along / np.maximum(
            1.0 - curvature * lateral_position, 0.2
        )
        return position.reshape(shape), lateral_position.reshape(shape)


def _points(length: int) -> FloatArray:
    """Grid points over ``length`` pixels, the first and the last beyond the edges [pixel]."""
    return np.arange(-(-length // CELL) + 1) * float(CELL)


def _spread_columns(values: FloatArray) -> FloatArray:
    """(rows, points) to (rows, pixels): linear between the points."""
    share = ((np.arange(CELL) + 0.5) / CELL).astype(np.float32)
    first = np.ascontiguousarray(values[:, :-1])[..., None]
    spread = np.diff(values, axis=1)[..., None] * share
    spread += first
    return spread.reshape(values.shape[0], -1)
