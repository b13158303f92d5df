"""One vehicle in the simulation's step, with a given speed profile and given steering."""

from typing import Any

import numpy as np
import numpy.typing as npt

from marl_lanes.traffic.machine.compiled import compiled
from marl_lanes.traffic.machine.state import VEHICLE, structure
from marl_lanes.traffic.parameters import Parameters
from marl_lanes.traffic.road.geometry import road_turn_rate
from marl_lanes.traffic.road.motion import integrate

FloatArray = npt.NDArray[np.float64]

YAW_RATE, LATERAL_SPEED, DEVIATION = range(3)
"""Rows of ``known``, the values after a step: yaw rate minus the road's turning [rad/s], lateral
speed [m/s] and deviation from the target lane's centre [m], in the maneuver frame."""

_DIFFERENCE = 1e-3
"""[rad/s^2] Half of the difference for a derivative. The step is smooth and almost linear: the
error is of second order in it, and rounding stays below 1e-10."""

_POLE = 1.2
"""[rad/s] Triple pole of the steering in ``Replay.steer``, which is as in lane keeping."""

_MIN_SPEED = 1.0
"""[m/s] As in lane keeping."""


@compiled
def advance(
    car: Any,
    speed: float,
    action: float,
    direction: float,
    centre: float,
    profiles: Any,
    arcs: Any,
    constants: Any,
    known: Any,
    k: int,
) -> None:
    """One time step to the given speed; writes the values after it to ``known[:, k]``."""
    turn_rate = road_turn_rate(car, arcs)
    car.acceleration = (speed - car.speed) / constants.time_step
    car.yaw_acceleration = direction * action
    lateral_position = car.lateral_position
    integrate(car, turn_rate, profiles, arcs, constants)
    known[0, k] = direction * (car.yaw_rate - road_turn_rate(car, arcs))
    # v sin psi, as in the completion criterion.
    known[1, k] = direction * (car.lateral_position - lateral_position) / constants.time_step
    known[2, k] = direction * (centre - car.lateral_position)


@compiled
def drive(
    cars: Any,
    begin: int,
    end: int,
    is_steering: bool,
    speed: Any,
    actions: Any,
    direction: float,
    centre: float,
    profiles: Any,
    arcs: Any,
    constants: Any,
    known: Any,
) -> None:
    """Steps ``begin`` to ``end``: ``cars[k]`` is the vehicle before step k, ``cars[k + 1]`` after.

    If ``is_steering``, lane keeping toward the centre chooses the actions and writes them.
    """
    bound = constants.max_yaw_acceleration
    for k in range(begin, end):
        cars[k + 1] = cars[k]
        car = cars[k + 1]
        if is_steering:
            turning = direction * (car.yaw_rate - road_turn_rate(car, arcs))
            error = direction * (centre - car.lateral_position) / max(car.speed, _MIN_SPEED)
            wanted = _POLE * _POLE * (_POLE * error - 3.0 * direction * car.yaw)
            actions[k] = min(max(wanted - 3.0 * _POLE * turning, -bound), bound)
        advance(car, speed[k], actions[k], direction, centre, profiles, arcs, constants, known, k)


@compiled
def respond(
    cars: Any,
    count: int,
    speed: Any,
    actions: Any,
    direction: float,
    centre: float,
    profiles: Any,
    arcs: Any,
    constants: Any,
    work: Any,
    known: Any,
    response: Any,
) -> None:
    """Central differences: ``response[:, k, j]`` is the derivative of ``known[:, k]`` by action j.

    Args:
        cars: (M + 1,) VEHICLE along the path, from ``drive``.
        count: number of steps with derivatives.
        speed: (M,) [m/s].
        actions: (M,) [rad/s^2].
        direction: +1 to the left, -1 to the right.
        centre: lateral position of the target lane's centre [m].
        profiles: (P,) PROFILE; the vehicle has the first.
        arcs: (K,) ARC.
        constants: of the scenario.
        work: (1,) VEHICLE, overwritten.
        known: (3, M), overwritten.
        response: (3, count, count), zeros above the diagonal.
    """
    for j in range(count):
        for sign in (1.0, -1.0):
            work[0] = cars[j]
            for k in range(j, count):
                action = actions[k] + sign * _DIFFERENCE if k == j else actions[k]
                advance(
                    work[0],
                    speed[k],
                    action,
                    direction,
                    centre,
                    profiles,
                    arcs,
                    constants,
                    known,
                    k,
                )
                for row in range(3):
                    change = sign * known[row, k] / (2.0 * _DIFFERENCE)
                    response[row, k, j] = change + (response[row, k, j] if sign < 0.0 else 0.0)


class Replay:
    """A vehicle's path at a given speed, as a function of its yaw accelerations.

    Args:
        parameters: of the scenario.
        speed: (M,) speed in each step [m/s].
        initial_speed: before the first step [m/s].
        position, lateral_position: s and d before the first step [m].
        yaw, yaw_rate: before the first step, in the maneuver frame [rad], [rad/s].
        direction: +1 to the left, -1 to the right.
        deviation: from the target lane's centre, in the maneuver frame [m].
    """

    def __init__(
        self,
        parameters: Parameters,
        speed: FloatArray,
        *,
        initial_speed: float,
        position: float,
        lateral_position: float,
        yaw: float,
        yaw_rate: float,
        direction: int,
        deviation: float,
    ) -> None:
        self.speed = speed
        self._cars = np.zeros(speed.size + 1, structure(VEHICLE))
        first = self._cars[0]
        first["position"], first["lateral_position"] = position, lateral_position
        first["speed"] = initial_speed
        first["yaw"], first["yaw_rate"] = direction * yaw, direction * yaw_rate
        self._actions = np.zeros(speed.size)
        self._known = np.zeros((3, speed.size))
        centre = lateral_position + direction * deviation
        given = parameters.profiles, parameters.arcs, parameters.constants[0]
        self._road = (float(direction), centre, *given)

    def steer(self, begin: int, end: int) -> None:
        """Let lane keeping toward the target lane choose the actions from begin to end."""
        self._drive(begin, end, is_steering=True)

    def follow(self, actions: FloatArray) -> FloatArray:
        """The values after each of the actions (N,): (3, N) float64."""
        self._actions[: actions.size] = actions
        self._drive(0, actions.size, is_steering=False)
        return self._known[:, : actions.size].copy()

    def path(self, count: int) -> npt.NDArray[np.void]:
        """The vehicle along the last actions.

        Args:
            count: number of steps N.

        Returns:
            (N + 1,) VEHICLE in the road frame: before the first step, and after each of them.
        """
        return np.asarray(self._cars[: count + 1].copy())

    def linearise(self, count: int) -> tuple[FloatArray, FloatArray]:
        """Around the last actions: the values without actions, and their derivative by actions.

        Returns:
            (3, count) and (3, count, count): known = free + response @ actions near the last ones.
        """
        known = self._known[:, :count].copy()
        response = np.zeros((3, count, count))
        respond(
            self._cars,
            count,
            self.speed,
            self._actions,
            *self._road,
            np.zeros(1, structure(VEHICLE)),
            np.zeros_like(self._known),
            response,
        )
        return known - response @ self._actions[:count], response

    def _drive(self, begin: int, end: int, *, is_steering: bool) -> None:
        drive(
            self._cars,
            begin,
            end,
            is_steering,
            self.speed,
            self._actions,
            *self._road,
            self._known,
        )
