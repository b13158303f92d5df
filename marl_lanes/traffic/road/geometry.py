"""Geometry: the road's curvature, its lanes, and the lanes that a body overlaps."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from marl_lanes.traffic.machine.compiled import compiled, internal

FloatArray = NDArray[np.float64]


@compiled
def arc_curvature(arc: Any, position: float) -> float:
    """An arc's curvature at a place in it [1/m], linear in its clothoids; positive bends left."""
    to_end = min(position - arc.start, arc.end - position)
    if to_end >= arc.transition:
        return float(arc.curvature)
    return float(arc.curvature * (to_end / arc.transition))


@compiled
def curvature_at(arcs: Any, position: float) -> float:
    """The road's curvature c(s) [1/m], 0 outside its arcs; positive bends left."""
    for arc in range(arcs.shape[0]):
        if arcs[arc].start <= position < arcs[arc].end:
            return arc_curvature(arcs[arc], position)
    return 0.0


@compiled
def road_turn_rate(car: Any, arcs: Any) -> float:
    """The road's turning under the car: c s' with s' = v cos(psi)/(1 - c d) [rad/s].

    1 - c d is above 0.5 on the road. It is not below 0.5 beside it: near the arc's centre the
    turning would be without bound.
    """
    curvature = curvature_at(arcs, car.position)
    if curvature == 0.0:
        return 0.0
    stretch = max(1.0 - curvature * car.lateral_position, 0.5)
    progress = car.speed * math.cos(car.yaw) / stretch
    return float(curvature * progress)


def road_turning(cars: Any, arcs: Any) -> tuple[FloatArray, FloatArray]:
    """The curvature [1/m] and ``road_turn_rate`` [rad/s] under each of N cars, (N,) float64."""
    curvature, turn_rate = np.empty(len(cars)), np.empty(len(cars))
    _read_turning(np.ascontiguousarray(cars), arcs, curvature, turn_rate)
    return curvature, turn_rate


@compiled
def _read_turning(cars: Any, arcs: Any, curvature: Any, turn_rate: Any) -> None:
    for index in range(cars.shape[0]):
        curvature[index] = curvature_at(arcs, cars[index].position)
        turn_rate[index] = road_turn_rate(cars[index], arcs)


@compiled
def wrap_angle(angle: float) -> float:
    """The same angle in (-pi, pi] [rad]."""
    return angle - 2.0 * math.pi * math.ceil((angle - math.pi) / (2.0 * math.pi))


@compiled
def lane_centre(lane: int, lane_width: float) -> float:
    """Lateral position of a lane's centre [m]."""
    return (lane + 0.5) * lane_width


@internal
def half_extent(yaw: float, profile: Any) -> float:
    """Half of the body's width across the road: (l/2)|sin psi| + (w/2)|cos psi| [m].

    ``profile`` is that of the driver, which has the body's size.
    """
    if yaw == 0.0:
        return float(profile.half_width)
    return turned_extent(math.sin(yaw), math.cos(yaw), profile)


@internal
def turned_extent(sine: float, cosine: float, profile: Any) -> float:
    """``half_extent`` from the sine and cosine of psi [m]."""
    return float(profile.half_length * abs(sine) + profile.half_width * abs(cosine))


@internal
def lane_under(lateral_position: float, constants: Any) -> int:
    """The lane at a lateral position [m]; beside the road the outermost one."""
    lane = math.floor(lateral_position / constants.lane_width)
    return int(min(max(lane, 0), constants.num_lanes - 1))


@internal
def occupy(car: Any, extent: float, constants: Any) -> None:
    """Set the lanes that the body overlaps; parts off the road count to the outermost lane."""
    car.lane_low = lane_under(car.lateral_position - extent, constants)
    car.lane_high = lane_under(car.lateral_position + extent, constants)


@internal
def is_body_in(car: Any, lane: int) -> Any:
    """Whether the body overlaps the lane."""
    # ``&`` and not ``and``, so that it also works on columns of a table.
    return (car.lane_low <= lane) & (lane <= car.lane_high)


@internal
def is_wholly_in(car: Any) -> Any:
    """Whether the body overlaps only the lane that the car keeps."""
    # ``&`` and not ``and``, so that it also works on columns of a table.
    return (car.lane_low == car.lane) & (car.lane == car.lane_high)


@internal
def is_off_road(car: Any, extent: float, constants: Any) -> bool:
    """Whether the body is over an edge of the road, or |yaw| is 90 degrees or more.

    ``extent`` is the body's ``half_extent`` [m].
    """
    if car.yaw == 0.0:
        return False
    width = constants.num_lanes * constants.lane_width
    return bool(
        car.lateral_position < extent
        or car.lateral_position > width - extent
        or abs(car.yaw) >= 0.5 * math.pi
    )
