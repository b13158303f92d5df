"""Motion of a vehicle: integration in the road (Frenet) frame, bounds of its acceleration."""

import math
from typing import Any

from marl_lanes.traffic.machine.compiled import compiled, internal
from marl_lanes.traffic.road.geometry import curvature_at, half_extent, occupy, turned_extent


@compiled
def integrate(car: Any, turn_rate: float, profiles: Any, arcs: Any, constants: Any) -> float:
    """One semi-implicit Euler step of dt with the car's acceleration and yaw acceleration.

    v += a dt (not below 0); omega += alpha dt, |omega| <= v/R_min; psi += (omega - c s') dt;
    s += v cos(psi)/(1 - c d) dt; d += v sin(psi) dt. Each formula uses the results of those
    before it. If v or omega reaches its bound, a or alpha is replaced by the applied value,
    (after - before)/dt.

    Returns:
        The body's ``half_extent`` after the step [m].
    """
    step = constants.time_step
    speed = car.speed + car.acceleration * step
    if speed < 0.0:
        car.acceleration = (0.0 - car.speed) / step
        speed = 0.0
    car.speed = speed
    # Most vehicles go straight: one comparison instead of four.
    if abs(car.yaw) + abs(car.yaw_rate) + abs(car.yaw_acceleration) + abs(turn_rate) == 0.0:
        car.advance = speed * step
        car.position += car.advance
        return half_extent(0.0, profiles[car.profile])
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
    car.advance = progress * step
    car.position += car.advance
    car.lateral_position += speed * sine * step
    extent = turned_extent(sine, cosine, profiles[car.profile])
    occupy(car, extent, constants)
    return float(extent)


@internal
def attainable(acceleration: float, car: Any, constants: Any) -> float:
    """The possible acceleration in a step if the driver wants this one [m/s^2].

    Not below the physical braking limit, and not below what stops the car within the step.
    """
    stopping = (0.0 - car.speed) / constants.time_step
    return float(max(acceleration, -constants.max_braking, stopping))
