"""Steering of the vehicles that no agent steers."""

from typing import Any

from marl_lanes.traffic.machine.compiled import compiled
from marl_lanes.traffic.road.geometry import lane_centre

_KEEPING_MIN_SPEED = 1.0
"""[m/s] Lane keeping divides by the speed, and uses at least this value."""

_KEEPING_MAX_LATERAL_SPEED = 1.0
"""[m/s] Lateral speed of lane keeping toward a lane that is far away."""

_KEEPING_MAX_HEADING = 0.15
"""[rad] Largest yaw that it aims at for that."""


@compiled
def keep_lane(car: Any, turn_rate: float, constants: Any) -> float:
    """p^3 e/v - 3 p^2 psi - 3 p (omega - c s'), bounded: yaw acceleration [rad/s^2].

    It gives e''' = -v yaw_acceleration three equal poles at -p; e is the distance to the centre of
    the car's lane, positive to the left. |e| is limited to 3/p min(1 m/s, 0.15 v): far from its
    lane the car moves sideways at about 1 m/s, or with a yaw of about 0.15 rad. Without this limit
    it would steer too hard there.
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
