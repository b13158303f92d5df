"""Model-predictive control of a lane change: the optimum's linear program at every time step.

The controller knows what an agent observes. So the speeds ahead are a prediction, and the road's
curvature stays as it is now.
"""

import math

import numpy as np
import numpy.typing as npt

from marl_lanes.evaluation.linear_program import Program, descend
from marl_lanes.evaluation.replay import DEVIATION, LATERAL_SPEED, YAW_RATE
from marl_lanes.scenario import Scenario

FloatArray = npt.NDArray[np.float64]

FADING = 3.5
"""[s] Time constant with which the present acceleration is predicted to fade."""

FIRST_DURATION = 6.0
"""[s] Duration with which the search begins."""

LONGEST_DURATION = 20.0
"""[s] Longest duration that is planned."""

MARGIN = 1e-4
"""[m], [m/s], [rad/s] Margin inside the completion criterion, because sin(yaw) is not yaw."""

SLACK = 1e-6
"""Tolerance of the bounds: the rounding of observations may put a plan's end beyond them."""

_MIN_SPEED = 1.0
"""[m/s] Below it sin(yaw) is far from yaw."""


class RecedingHorizon:
    """Plans the cheapest lane change from the present state; only its first action is carried out.

    minimum over N and a of sum_k w_a |a_k| + w_w |w_k+1| + w_d |e_k+1| / d_avg, as in
    ``optimal_lane_change``, with

        v_k = v + A F (1 - exp(-k dt / F))      predicted speed, A the present acceleration;
                                                a lower speed than 1 m/s counts as 1 m/s
        w_k+1 = w_k + a_k dt,  psi_k+1 = psi_k + w_k+1 dt,  e_k+1 = e_k - v_k+1 psi_k+1 dt

    Nothing is kept from one step to the next.

    Args:
        scenario: gives time step, reward, completion and the bound of the action.
    """

    def __init__(self, scenario: Scenario) -> None:
        completion = scenario.completion
        bounds = np.full(3, np.inf)
        bounds[DEVIATION] = completion.max_deviation
        bounds[LATERAL_SPEED] = completion.max_lateral_speed or np.inf
        bounds[YAW_RATE] = completion.max_yaw_rate or np.inf
        self.bounds = bounds - MARGIN
        self.reward = scenario.reward
        self.max_yaw_acceleration = scenario.action.max_yaw_acceleration
        self.time_step = scenario.time_step
        self.first = round(FIRST_DURATION / self.time_step)
        self.longest = round(LONGEST_DURATION / self.time_step)
        steps = np.arange(1, self.longest + 1)
        self.times = steps * self.time_step
        self.gains = FADING * -np.expm1(-self.times / FADING)
        # Of yaw rate and yaw by the actions: the same for every speed.
        self.yaw_rates = np.tril(np.full((self.longest, self.longest), self.time_step))
        self.yaws = self.time_step * np.cumsum(self.yaw_rates, axis=0)

    def plan(
        self, speed: float, deviation: float, yaw: float, yaw_rate: float, acceleration: float
    ) -> tuple[float, FloatArray]:
        """The predicted cost of the cheapest lane change, and its actions.

        Args:
            speed: [m/s].
            deviation: from the target lane's centre, in the maneuver frame [m].
            yaw: relative to the road [rad].
            yaw_rate: relative to the road's turning [rad/s].
            acceleration: longitudinal [m/s^2].

        Returns:
            the cost; and the yaw accelerations (N,) [rad/s^2]. If no duration up to
            LONGEST_DURATION completes, the cost is infinite, and the actions are those of the
            longest one that come nearest.
        """
        state = speed, deviation, yaw, yaw_rate, acceleration
        size = self.first
        while True:
            program = self._program(size, *state)
            cost, actions = program.solve(size)
            is_possible = math.isfinite(cost)
            # Far above the best duration the cost is flat, and the actions complete before the end.
            start = program.first_completion(actions) if is_possible else size
            if start < size or (is_possible and size == self.longest):
                break
            if size == self.longest:
                bound = self.max_yaw_acceleration
                return math.inf, np.clip(program.approach(size), -bound, bound)
            size = min(self.longest, size + size // 2)
        solved = {size: (cost, actions)}

        def cost_of(num_steps: int) -> float:
            if num_steps not in solved:
                solved[num_steps] = program.solve(num_steps)
            return solved[num_steps][0]

        return solved[descend(cost_of, start, size)]

    def steer(
        self,
        speed: FloatArray,
        deviation: FloatArray,
        yaw: FloatArray,
        yaw_rate: FloatArray,
        acceleration: FloatArray,
    ) -> FloatArray:
        """The first action of each agent's plan, (N,) [rad/s^2]; arguments (N,) as of ``plan``."""
        states = np.column_stack([speed, deviation, yaw, yaw_rate, acceleration]).tolist()
        return np.array([self.plan(*state)[1][0] for state in states])

    def _program(
        self,
        size: int,
        speed: float,
        deviation: float,
        yaw: float,
        yaw_rate: float,
        acceleration: float,
    ) -> Program:
        """The linear programs of 1 ... size steps from this state."""
        free, response = np.empty((3, size)), np.empty((3, size, size))
        speeds = np.maximum(_MIN_SPEED, speed + acceleration * self.gains[:size])
        free[YAW_RATE], response[YAW_RATE] = yaw_rate, self.yaw_rates[:size, :size]
        free[LATERAL_SPEED] = speeds * (yaw + yaw_rate * self.times[:size])
        response[LATERAL_SPEED] = speeds[:, np.newaxis] * self.yaws[:size, :size]
        free[DEVIATION] = deviation - self.time_step * np.cumsum(free[LATERAL_SPEED])
        response[DEVIATION] = -self.time_step * np.cumsum(response[LATERAL_SPEED], axis=0)
        return Program(
            free,
            response,
            bounds=self.bounds,
            max_yaw_acceleration=self.max_yaw_acceleration,
            reward=self.reward,
            slack=SLACK,
        )
