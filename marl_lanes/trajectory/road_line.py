"""The road in the plane: from positions along it to x and y."""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from marl_lanes.scenario import Scenario
from marl_lanes.traffic.parameters import make_parameters
from marl_lanes.traffic.road.geometry import curvature_at

FloatArray = NDArray[np.float64]

_SPACING = 0.5
"""[m] Between the points of the line: at a radius of 50 m the chord is 0.6 mm off the arc."""

MARGIN = 500.0
"""[m] The road goes on straight this far before its start and behind its end."""


class RoadLine:
    """The right edge of a road as a line in the plane.

    It starts at the origin and heads along x; y is positive to the left. The heading is the
    integral of the curvature, and the line that of the heading.

    Args:
        scenario: of the road.

    Attributes:
        position: (P,) float64 ascending, along the line, beyond both ends of the road [m].
        x, y: (P,) float64, the points of the line [m].
        heading: (P,) float64 [rad].
    """

    def __init__(self, scenario: Scenario) -> None:
        arcs = make_parameters(scenario).arcs
        length = scenario.road.length
        if not arcs.size:
            self.position = np.asarray([-MARGIN, 0.0, length, length + MARGIN])
            curvature = np.zeros(4)
        else:
            count = math.ceil((length + 2.0 * MARGIN) / _SPACING) + 1
            # The origin is one of the points.
            self.position = np.arange(count) * _SPACING - MARGIN
            curvature = np.asarray([curvature_at(arcs, place) for place in self.position.tolist()])
        self.heading = self._integrate(curvature)
        self.x = self._integrate(np.cos(self.heading))
        self.y = self._integrate(np.sin(self.heading))

    def _integrate(self, values: FloatArray) -> FloatArray:
        """The integral over the position by trapezoids, 0 at the road's start."""
        pieces = 0.5 * (values[1:] + values[:-1]) * np.diff(self.position)
        total = np.concatenate([[0.0], np.cumsum(pieces)])
        return np.asarray(total - total[np.searchsorted(self.position, 0.0)])

    def place(
        self, position: ArrayLike, lateral_position: ArrayLike
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Plane coordinates x [m], y [m] and the road's heading [rad] at places on the road.

        Args:
            position: along the right edge, any shape [m]. Beyond the line's ends: that of the end.
            lateral_position: from the right edge, positive left, of the same shape [m].
        """
        along = np.asarray(position, np.float64)
        heading = np.interp(along, self.position, self.heading)
        x = np.interp(along, self.position, self.x) - np.sin(heading) * lateral_position
        y = np.interp(along, self.position, self.y) + np.cos(heading) * lateral_position
        return x, y, heading
