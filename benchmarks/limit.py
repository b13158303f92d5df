"""Only the necessary work of a step of many roads: the limit for the simulator's speed.

IDM with two leaders, yaw, integration, sorting; no agents, no departures, no collisions, no
observations, no random numbers. Vehicles that reach the road's end start again.
"""

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

_STEP = 0.1
_LANE_WIDTH = 3.75
_LENGTH = 4.8


@numba.njit(cache=True, nogil=True, error_model="numpy")
def advance(
    start: int,
    stop: int,
    road_length: float,
    position: Any,
    lateral_position: Any,
    speed: Any,
    acceleration: Any,
    yaw: Any,
    yaw_rate: Any,
    desired_speed: Any,
    lane: Any,
    order: Any,
    nearest: Any,
) -> None:
    """Advance the roads from ``start`` to ``stop`` by one time step.

    Args:
        start: first road.
        stop: the road after the last.
        road_length: [m].
        position: and the next six, (E, V) float64.
        lateral_position: [m].
        speed: [m/s].
        acceleration: [m/s^2].
        yaw: [rad].
        yaw_rate: [rad/s].
        desired_speed: [m/s].
        lane: (E, V) int32, the lane that a vehicle keeps.
        order: (E, V) int32, vehicles by decreasing position.
        nearest: (E, L) int32, the vehicle last seen in each lane.
    """
    num_vehicles = position.shape[1]
    last = nearest.shape[1] - 1
    for env in range(start, stop):
        for index in range(last + 1):
            nearest[env, index] = -1
        for rank in range(num_vehicles):
            car = order[env, rank]
            kept = lane[env, car]
            interaction = 0.0
            # The second leader is in the lane to the left, as during a lane change.
            for other in range(kept, min(kept + 1, last) + 1):
                front = nearest[env, other]
                if front >= 0:
                    gap = max(position[env, front] - position[env, car] - _LENGTH, 0.01)
                    closing = speed[env, car] - speed[env, front]
                    wanted = speed[env, car] * (1.0 + closing / 3.4641016151377544)
                    ratio = (5.0 + max(0.0, wanted)) / gap
                    interaction = max(interaction, ratio * ratio)
            square = (speed[env, car] / desired_speed[env, car]) ** 2
            wanted = 2.0 * (1.0 - max(square * square, interaction))
            acceleration[env, car] = max(wanted, -8.0)
            nearest[env, kept] = car
        for rank in range(num_vehicles):
            car = order[env, rank]
            velocity = max(0.0, speed[env, car] + acceleration[env, car] * _STEP)
            # An undamped oscillation about the road's direction, so that every vehicle turns.
            rate = yaw_rate[env, car] - 4.0 * yaw[env, car] * _STEP
            heading = yaw[env, car] + rate * _STEP
            speed[env, car] = velocity
            yaw_rate[env, car] = rate
            yaw[env, car] = heading
            position[env, car] += velocity * np.cos(heading) * _STEP
            lateral_position[env, car] += velocity * np.sin(heading) * _STEP
            if position[env, car] >= road_length:
                position[env, car] -= road_length
            below = rank - 1
            while below >= 0 and position[env, order[env, below]] < position[env, car]:
                order[env, below + 1] = order[env, below]
                below -= 1
            order[env, below + 1] = car


class Limit:
    """E roads with V vehicles each, moved by ``advance``.

    Args:
        num_envs: E.
        num_vehicles: V.
        num_lanes: L.
        road_length: [m].
    """

    def __init__(
        self, num_envs: int, num_vehicles: int, num_lanes: int = 3, road_length: float = 1000.0
    ) -> None:
        self.num_envs, self.num_vehicles = num_envs, num_vehicles
        shape = (num_envs, num_vehicles)
        random = np.random.default_rng(0)
        even = np.arange(num_vehicles, 0, -1) * (road_length / (num_vehicles + 1))
        lane = np.broadcast_to(np.arange(num_vehicles, dtype=np.int32) % num_lanes, shape).copy()
        self._road_length = road_length
        self._arrays: tuple[NDArray[Any], ...] = (
            np.broadcast_to(even, shape).copy(),
            (lane + 0.5) * _LANE_WIDTH,
            random.uniform(20.0, 25.0, shape),
            np.zeros(shape),
            random.uniform(-0.02, 0.02, shape),
            np.zeros(shape),
            random.uniform(22.0, 33.0, shape),
            lane,
            np.broadcast_to(np.arange(num_vehicles, dtype=np.int32), shape).copy(),
            np.full((num_envs, num_lanes), -1, np.int32),
        )

    def advance(self, start: int, stop: int) -> None:
        """Advance the roads from ``start`` to ``stop`` by one time step."""
        advance(start, stop, self._road_length, *self._arrays)
