"""Linear programs of a lane change: its motion is linear in the actions."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from marl_lanes.evaluation.replay import DEVIATION, LATERAL_SPEED, YAW_RATE
from marl_lanes.evaluation.simplex import minimise
from marl_lanes.scenario.agent import Reward

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Program:
    """The linear programs of 1 ... M steps: N steps use the first N rows and columns.

    The values after each step are free + response @ actions. A row does not depend on later
    actions, so the arrays are built once for all durations.

    Args:
        free: (3, M), rows as in replay.py.
        response: (3, M, M), lower triangles.
        bounds: (3,), of the values after the last step; infinite for no bound.
        max_yaw_acceleration: bound on the actions [rad/s^2].
        reward: its three weights (Eq. 10, Eq. 11, Eq. 12).
        slack: tolerance of every bound for rounding [m], [m/s], [rad/s], [rad/s^2].
        gamma: discount factor of each step's cost.
    """

    free: FloatArray
    response: FloatArray
    bounds: FloatArray
    max_yaw_acceleration: float
    reward: Reward
    slack: float = 1e-8
    gamma: float = 1.0

    @property
    def size(self) -> int:
        """M."""
        return int(self.free.shape[1])

    def solve(self, num_steps: int) -> tuple[float, FloatArray]:
        """Lowest cost of N steps and its actions (N,); infinite and empty without a solution.

        Minimum of sum_k gamma^k (w_a |a_k| + w_w |turning_k| + w_d |deviation_k| / d_avg), with
        |a_k| <= a_max and the values after the last step within their bounds.
        """
        actions, is_within, cost = self._minimise(num_steps)
        return (cost, actions) if is_within else (math.inf, np.empty(0))

    def approach(self, num_steps: int) -> FloatArray:
        """The actions (N,) that come nearest to the bounds, where ``solve`` finds no solution."""
        return self._minimise(num_steps)[0]

    def _minimise(self, num_steps: int) -> tuple[FloatArray, bool, float]:
        """The actions, whether every bound holds, and the cost."""
        n = num_steps
        free = np.concatenate([self.free[YAW_RATE, :n], self.free[DEVIATION, :n]])
        free = np.append(free, self.free[LATERAL_SPEED, n - 1])
        response = np.concatenate(
            [
                self.response[YAW_RATE, :n, :n],
                self.response[DEVIATION, :n, :n],
                self.response[LATERAL_SPEED, n - 1 : n, :n],
            ]
        )
        weights = np.zeros(3 * n + 1)
        weights[:n] = self.reward.yaw_acceleration_weight
        weights[n : 2 * n] = self.reward.yaw_rate_weight
        weights[2 * n : 3 * n] = self.reward.deviation_weight / self.reward.average_deviation
        weights[: 3 * n] *= np.tile(self.gamma ** np.arange(n), 3)
        bounds = np.full(3 * n + 1, np.inf)
        bounds[:n] = self.max_yaw_acceleration
        bounds[[2 * n - 1, 3 * n - 1, 3 * n]] = self.bounds[[YAW_RATE, DEVIATION, LATERAL_SPEED]]
        actions = minimise(free, response, weights, bounds)
        values = np.abs(np.concatenate([actions, free + response @ actions]))
        return actions, bool((values <= bounds + self.slack).all()), float(weights @ values)

    def first_completion(self, yaw_acceleration: FloatArray) -> int:
        """Number of steps after which the actions (N,) first complete; N if they never do."""
        n = yaw_acceleration.size
        known = self.free[:, :n] + self.response[:, :n, :n] @ yaw_acceleration
        is_there = (np.abs(known) <= self.bounds[:, np.newaxis] + self.slack).all(axis=0)
        return int(np.argmax(is_there)) + 1 if is_there.any() else n


def descend(cost_of: Callable[[int], float], start: int, longest: int) -> int:
    """Descend to a local minimum of the cost over the duration."""
    best = start
    while True:
        # Among equal costs the shortest duration.
        near = [n for n in (best - 1, best, best + 1) if 1 <= n <= longest]
        cheapest = min(near, key=cost_of)
        if cost_of(cheapest) == cost_of(best) and cheapest >= best:
            return best
        best = cheapest
