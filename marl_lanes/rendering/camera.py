"""The camera: from places on the road to pixels, and from pixels to places on the road."""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from marl_lanes.scenario import Scenario
from marl_lanes.trajectory.road_line import RoadLine

FloatArray = NDArray[np.float64]
SingleArray = NDArray[np.float32]

BEHIND = 0.42
"""Share of the picture's width that lies behind the followed vehicle."""

MARGIN = 4.0
"""[m] Least strip of ground beside the road."""

_CELL = 16
"""[pixel] Between the points at which places on the road are computed; linear in between."""

_SPACING = 8.0
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
        self._weights_x = _make_weights(size[0])
        self._weights_y = _make_weights(size[1])
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
        reach = 0.5 * self.size[0] / self.scale
        first = max(self.start - reach, float(self._line.position[0]))
        last = min(self.end + reach, float(self._line.position[-1]))
        self._samples = np.arange(first, last, _SPACING / self.scale)
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

    def look_up(self) -> tuple[SingleArray, SingleArray]:
        """Position and lateral position [m] of the middle of each pixel.

        Returns:
            arrays that broadcast to (height, width): (1, width) and (height, 1) where the road in
            the picture is straight, else both (height, width).
        """
        width, height = self.size
        if self._is_straight:
            along, across = self._to_plane(np.arange(width) + 0.5, np.arange(height) + 0.5)
            position = self.position + along
            lateral_position = 0.5 * self.road_width + across
            return position[None].astype(np.float32), lateral_position[:, None].astype(np.float32)
        columns, rows = _points(width), _points(height)
        ahead, left = self._to_plane(columns, rows)
        position, lateral_position = self._find_nearest(ahead, left)
        found = [
            self._weights_y @ grid.astype(np.float32) @ self._weights_x.T
            for grid in (position, lateral_position)
        ]
        return found[0], found[1]

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
    return np.arange(-(-length // _CELL) + 1) * float(_CELL)


def _make_weights(length: int) -> SingleArray:
    """(length, points) weights of the linear interpolation at the pixels' middles."""
    place = (np.arange(length) + 0.5) / _CELL
    index = place.astype(np.intp)
    weights = np.zeros((length, _points(length).size), np.float32)
    rows = np.arange(length)
    weights[rows, index] = 1.0 - (place - index)
    weights[rows, index + 1] = place - index
    return weights
