"""Steering of the vehicles that no agent steers."""

from typing import Any

from marl_lanes.traffic.machine.compiled import compiled
from marl_lanes.traffic.road.geometry import lane_centre

_KEEPING_MIN_SPEED = 1.0
"""[m/s] Lane keeping divides by the speed; below this it steers as if it went this fast."""

_KEEPING_MAX_LATERAL_SPEED = 1.0
"""[m/s] How fast lane keeping goes sideways to a lane that is far off."""

_KEEPING_MAX_HEADING = 0.15
"""[rad] How far it turns from the road's direction for that."""


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
