"""Longitudinal and yaw integration in the road (Frenet) frame; lane keeping."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from marl_lanes.traffic.compiled import compiled, internal

FloatArray = NDArray[np.float64]

_KEEPING_MIN_SPEED = 1.0
"""[m/s] Lane keeping divides by the speed; below this it steers as if it went this fast."""

_KEEPING_MAX_LATERAL_SPEED = 1.0
"""[m/s] How fast lane keeping goes sideways to a lane that is far off."""

_KEEPING_MAX_HEADING = 0.15
"""[rad] How far it turns from the road's direction for that."""


@compiled
def arc_curvature(arc: Any, position: float) -> float:
    """The curvature of an arc within it [1/m], linear in its clothoids; positive bends left."""
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
    """How fast the road turns under the car: c s', s' = v cos(psi)/(1 - c d) [rad/s]."""
    curvature = curvature_at(arcs, car.position)
    if curvature == 0.0:
        return 0.0
    progress = car.speed * math.cos(car.yaw) / (1.0 - curvature * car.lateral_position)
    return float(curvature * progress)


def road_turning(cars: Any, arcs: Any) -> tuple[FloatArray, FloatArray]:
    """Under each of N cars: the curvature [1/m] and ``road_turn_rate`` [rad/s], (N,) float64."""
    curvature, turn_rate = np.empty(len(cars)), np.empty(len(cars))
    _read_turning(np.ascontiguousarray(cars), arcs, curvature, turn_rate)
    return curvature, turn_rate


@compiled
def _read_turning(cars: Any, arcs: Any, curvature: Any, turn_rate: Any) -> None:
    for index in range(cars.shape[0]):
        curvature[index] = curvature_at(arcs, cars[index].position)
        turn_rate[index] = road_turn_rate(cars[index], arcs)


@compiled
def lane_centre(lane: int, lane_width: float) -> float:
    """Lateral position of a lane's centre [m]."""
    return (lane + 0.5) * lane_width


@internal
def half_extent(yaw: float, constants: Any) -> float:
    """Half of the body's width across the road: (l/2)|sin psi| + (w/2)|cos psi| [m]."""
    if yaw == 0.0:
        return 0.5 * float(constants.vehicle_width)
    return turned_extent(math.sin(yaw), math.cos(yaw), constants)


@internal
def turned_extent(sine: float, cosine: float, constants: Any) -> float:
    """``half_extent`` where the sine and cosine of psi are at hand [m]."""
    across = constants.vehicle_length * abs(sine)
    return 0.5 * float(across + constants.vehicle_width * abs(cosine))


@compiled
def keep_lane(car: Any, turn_rate: float, constants: Any) -> float:
    """p^3 e/v - 3 p^2 psi - 3 p (omega - c s'), bounded: yaw acceleration [rad/s^2].

    Three equal poles at -p of e''' = -v yaw_acceleration, e the distance to the centre of the
    car's lane, positive to the left. |e| counts up to 3/p min(1 m/s, 0.15 v), from where the car
    goes sideways at 1 m/s or turns 0.15 rad from the road: far from its lane the linear law would
    be violent.
    """
    error = lane_centre(car.lane, constants.lane_width) - car.lateral_position
    turning = car.yaw_rate - turn_rate
    if abs(error) + abs(car.yaw) + abs(turning) == 0.0:
        return 0.0
    pole = constants.keeping_pole
    speed = max(car.speed, _KEEPING_MIN_SPEED)
    reach = 3.0 / pole * min(_KEEPING_MAX_LATERAL_SPEED, _KEEPING_MAX_HEADING * speed)
    error = min(max(error, -reach), reach)
    steering = pole * pole * (pole * error / speed - 3.0 * car.yaw) - 3.0 * pole * turning
    bound = constants.keeping_max_yaw_acceleration
    return float(min(max(steering, -bound), bound))


@compiled
def integrate(car: Any, turn_rate: float, arcs: Any, constants: Any) -> float:
    """One semi-implicit Euler step of dt under the car's acceleration and yaw acceleration.

    v += a dt (not below 0); omega += alpha dt, |omega| <= v/R_min; psi += (omega - c s') dt;
    s += v cos(psi)/(1 - c d) dt; d += v sin(psi) dt. Each line uses what the lines before it gave.
    Where a bound holds, a or alpha becomes what was applied: (after - before)/dt.

    Returns:
        Half of the body's width across the road afterwards, as ``half_extent`` [m].
    """
    step = constants.time_step
    speed = car.speed + car.acceleration * step
    if speed < 0.0:
        car.acceleration = (0.0 - car.speed) / step
        speed = 0.0
    car.speed = speed
    # Most vehicles go straight: one comparison instead of four.
    if abs(car.yaw) + abs(car.yaw_rate) + abs(car.yaw_acceleration) + abs(turn_rate) == 0.0:
        car.position += speed * step
        return half_extent(0.0, constants)
    fastest = speed / constants.min_turning_radius
    yaw_rate = car.yaw_rate + car.yaw_acceleration * step
    if abs(yaw_rate) > fastest:
        yaw_rate = min(max(yaw_rate, -fastest), fastest)
        car.yaw_acceleration = (yaw_rate - car.yaw_rate) / step
    car.yaw_rate = yaw_rate
    car.yaw += (car.yaw_rate - turn_rate) * step
    sine, cosine = math.sin(car.yaw), math.cos(car.yaw)
    curvature = curvature_at(arcs, car.position)
    progress = speed * cosine / (1.0 - curvature * car.lateral_position)
    car.position += progress * step
    car.lateral_position += speed * sine * step
    extent = turned_extent(sine, cosine, constants)
    occupy(car, extent, constants)
    return float(extent)


@internal
def attainable(acceleration: float, car: Any, constants: Any) -> float:
    """The acceleration that a driver who wants this one can have in a step [m/s^2].

    Not below the physical braking limit, nor below what brings the car to a standstill.
    """
    stopping = (0.0 - car.speed) / constants.time_step
    return float(max(acceleration, -constants.max_braking, stopping))


@internal
def occupy(car: Any, extent: float, constants: Any) -> None:
    """Set the lanes that the body overlaps, off-road parts counted to the outermost lane."""
    last = constants.num_lanes - 1
    low = math.floor((car.lateral_position - extent) / constants.lane_width)
    high = math.floor((car.lateral_position + extent) / constants.lane_width)
    car.lane_low = min(max(low, 0), last)
    car.lane_high = min(max(high, 0), last)
