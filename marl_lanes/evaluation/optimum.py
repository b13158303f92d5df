"""The cheapest lane change for a given speed profile, as a linear program.

It is what a lane changer is held against: the reward's own terms as the cost, the completion
criterion as the terminal set, small angles, the duration free. Only the lateral motion is
optimised; the speed profile is the maneuver's own.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import linprog

from marl_lanes.scenario.schema import Completion, Reward

FloatArray = npt.NDArray[np.float64]

MAX_EXTENSION = 20.0
"""[s] How much longer than the recorded maneuver the optimum may take."""

_BRACKET_STRIDE = 6
"""Steps; wide enough to cross the flat floor around the optimum, and small bumps in it."""

_COMPLETION_SLACK = 1e-7
"""[m], [m/s], [rad/s] The solver's own tolerance."""

# linprog's result.status.
_LINPROG_OPTIMAL = 0
_LINPROG_UNBOUNDED = 3


@dataclass(frozen=True, eq=False)
class Optimum:
    """The cheapest lane change.

    Args:
        total_return: the sum of its rewards, the negative of its cost [1].
        num_steps: its duration N in time steps.
        yaw_acceleration: the action of each step, (N,) float64 [rad/s^2].
    """

    total_return: float
    num_steps: int
    yaw_acceleration: FloatArray


def optimal_lane_change(
    speed: npt.ArrayLike,
    *,
    time_step: float,
    deviation: float,
    yaw: float = 0.0,
    yaw_rate: float = 0.0,
    curvature: npt.ArrayLike = 0.0,
    max_yaw_acceleration: float,
    reward: Reward,
    completion: Completion,
) -> Optimum:
    """Minimum over N and a of sum_k w_a |a_k| + w_w |omega_k+1 - c_k v_k| + w_d |d_k+1| / d_avg.

    The sum runs over k = 0 ... N-1, with the simulator's semi-implicit step at small angles::

        omega_k+1 = omega_k + a_k dt
        psi_k+1   = psi_k + (omega_k+1 - c_k v_k) dt
        d_k+1     = d_k - v_k psi_k+1 dt

    subject to |a_k| <= max_yaw_acceleration, |d_N| <= max_deviation and, where they are set,
    |v_N-1 psi_N| <= max_lateral_speed and |omega_N - c_N-1 v_N-1| <= max_yaw_rate, for N >= 1.

    A maneuver ends at the first step at which it is completed; the program asks for completion at
    step N only, which can only lower its cost. It loses nothing by that: what leads to an earlier
    completion is itself a candidate, of smaller N and no greater cost. Hence this is the optimum
    of the linear model, and a lower bound for a simulated maneuver up to the small-angle error.

    The search over N starts near the recorded duration and takes the cost to fall and then to
    rise with N. Under smooth speed profiles it does. Where the speed swings by several m/s within
    one maneuver there can be a second dip, and the one found can cost a few percent too much.

    Args:
        speed: recorded speed used in each step, (K,) [m/s], K >= 1; its last value goes on.
        time_step: dt [s].
        deviation: d_0, lateral deviation from the target lane's centre, positive on the side
            from which a positive yaw leads back to it [m].
        yaw: psi_0, yaw relative to the road [rad].
        yaw_rate: omega_0, absolute, so it includes the road's own turning [rad/s].
        curvature: c, of the road in each step, a number or (K,) [1/m]; its last value goes on.
        max_yaw_acceleration: bound on |a_k| [rad/s^2].
        reward: the cost's weights; its failure penalty plays no part.
        completion: the terminal set.

    Returns:
        The optimum.

    Raises:
        ValueError: an input is empty, of the wrong shape, not finite or out of range; or no
            duration tried, up to MAX_EXTENSION beyond the recorded one, reaches the terminal set.
        RuntimeError: the solver failed.

    Source: the cost is paper eq. 10-13.
    """
    for name, value in (("time_step", time_step), ("max_yaw_acceleration", max_yaw_acceleration)):
        if not (math.isfinite(value) and value > 0.0):
            raise ValueError(f"{name} is {value!r}; it must be finite and positive")
    for name, value in (("deviation", deviation), ("yaw", yaw), ("yaw_rate", yaw_rate)):
        if not math.isfinite(value):
            raise ValueError(f"{name} is {value!r}; it must be finite")
    speed_profile, curvature_profile = _checked_profiles(speed, curvature)

    num_recorded = speed_profile.size
    num_extra = math.ceil(MAX_EXTENSION / time_step)
    program = _Program.build(
        np.pad(speed_profile, (0, num_extra), mode="edge"),
        np.pad(curvature_profile, (0, num_extra), mode="edge"),
        time_step=time_step,
        initial=(deviation, yaw, yaw_rate),
        max_yaw_acceleration=max_yaw_acceleration,
        reward=reward,
        completion=completion,
    )
    solved: dict[int, tuple[float, FloatArray]] = {}

    def cost_of(num_steps: int) -> float:
        if num_steps not in solved:
            solved[num_steps] = program.solve(num_steps)
        return solved[num_steps][0]

    longest = num_recorded + num_extra
    start = num_recorded
    while math.isinf(cost_of(start)):
        if start == longest:
            raise ValueError(
                f"deviation is {deviation!r} m; it must be one that |yaw acceleration| <= "
                f"{max_yaw_acceleration!r} rad/s^2 can bring to ({completion}) at the recorded "
                f"speed within {longest} steps of {time_step!r} s"
            )
        start = min(longest, start + max(1, start // 2))
    # Far beyond the optimum the cost is flat, and its actions complete long before they end.
    start = min(program.first_completion(solved[start][1]), start, key=cost_of)
    best = _cheapest_duration(cost_of, start=start, longest=longest)
    cost, yaw_acceleration = solved[best]
    return Optimum(total_return=-cost, num_steps=best, yaw_acceleration=yaw_acceleration)


def _cheapest_duration(cost_of: Callable[[int], float], *, start: int, longest: int) -> int:
    """Argmin of a cost that falls and then rises over 1 ... longest.

    A wide stride brackets the optimum, a parabola through the bracket guesses it, single steps
    settle it: about seven costs where the start is near.

    Args:
        cost_of: cost of a duration, infinite where the terminal set is out of reach; a call is
            expensive, repeating one is not.
        start: the first duration tried, of finite cost.
        longest: the last one allowed.
    """
    best = _descend(cost_of, start, _BRACKET_STRIDE, longest)
    left, right = best - _BRACKET_STRIDE, best + _BRACKET_STRIDE
    if left >= 1 and right <= longest and math.isfinite(cost_of(left) + cost_of(right)):
        fall, rise = cost_of(left) - cost_of(best), cost_of(right) - cost_of(best)
        if fall + rise > 0.0:
            # Neither is negative, so the vertex lies within half a stride of best.
            vertex = best + round(_BRACKET_STRIDE * (fall - rise) / (2.0 * (fall + rise)))
            best = min(best, vertex, key=cost_of)
    return _descend(cost_of, best, 1, longest)


def _descend(cost_of: Callable[[int], float], start: int, stride: int, longest: int) -> int:
    """Walk downhill to a duration from which a stride either way costs no less."""
    best = start
    directions: tuple[int, ...] = (-1, 1)
    while True:
        candidates = [best + direction * stride for direction in directions]
        better = [n for n in candidates if 1 <= n <= longest and cost_of(n) < cost_of(best)]
        if not better:
            return best
        cheapest = min(better, key=cost_of)
        directions = (1 if cheapest > best else -1,)
        best = cheapest


@dataclass(frozen=True, eq=False)
class _Program:
    """The linear programs of 1 ... M steps: that of N has the first N rows and columns of these.

    The motion is linear in the actions, x = free + response @ a, a row for the end of each step.
    A row depends on no later action, so the arrays are built once for all durations.

    Args:
        speed: (M,) [m/s].
        free_yaw_rate, free_yaw, free_deviation: the motion without action, the first two relative
            to the road, each (M,) [rad/s], [rad], [m].
        yaw_rate_response, yaw_response, deviation_response: derivatives by the actions, (M, M).
    """

    speed: FloatArray
    free_yaw_rate: FloatArray
    free_yaw: FloatArray
    free_deviation: FloatArray
    yaw_rate_response: FloatArray
    yaw_response: FloatArray
    deviation_response: FloatArray
    max_yaw_acceleration: float
    reward: Reward
    completion: Completion

    @classmethod
    def build(
        cls,
        speed: FloatArray,
        curvature: FloatArray,
        *,
        time_step: float,
        initial: tuple[float, float, float],
        max_yaw_acceleration: float,
        reward: Reward,
        completion: Completion,
    ) -> "_Program":
        """Write the steps out as cumulative sums; initial is (deviation, yaw, yaw rate)."""
        deviation, yaw, yaw_rate = initial
        advance = time_step * speed
        free_yaw_rate = yaw_rate - curvature * speed
        free_yaw = yaw + time_step * np.cumsum(free_yaw_rate)
        yaw_rate_response = time_step * np.tri(speed.size)
        yaw_response = time_step * np.cumsum(yaw_rate_response, axis=0)
        return cls(
            speed=speed,
            free_yaw_rate=free_yaw_rate,
            free_yaw=free_yaw,
            free_deviation=deviation - np.cumsum(advance * free_yaw),
            yaw_rate_response=yaw_rate_response,
            yaw_response=yaw_response,
            deviation_response=-np.cumsum(advance[:, np.newaxis] * yaw_response, axis=0),
            max_yaw_acceleration=max_yaw_acceleration,
            reward=reward,
            completion=completion,
        )

    def solve(self, num_steps: int) -> tuple[float, FloatArray]:
        """Cost and actions (N,) of the cheapest N steps; infinite and empty where there are none.

        What is solved is the dual: N rows and few pivots, two to three times as fast as the
        primal with its three rows a step. For w |x| is the maximum of y x over |y| <= w, and the
        terminal bound |x| <= b that of (p - q) x - (p + q) b over p, q >= 0: the cost becomes a
        maximum over (y, p, q) of something linear in a, whose minimum over |a| <= a_max the
        slacks r, s >= 0 below pay for. With x = free + R a, and x_N = free_N + R_N a::

            max  y . free + (p - q) . free_N - (p + q) . b - a_max sum(r + s)
            s.t. R' y + z + R_N' (p - q) + r - s = 0,  |y| <= w,  |z| <= w_a

        The multipliers of its rows are the actions. It is unbounded exactly where there are none.
        """
        n = num_steps
        end_free, end_response, end_bound = self._terminal_rows(n)
        zeros, ones, identity = np.zeros(n), np.ones(n), np.eye(n)
        columns = np.hstack(
            [
                self.yaw_rate_response[:n, :n].T,
                self.deviation_response[:n, :n].T,
                identity,
                end_response.T,
                -end_response.T,
                identity,
                -identity,
            ]
        )
        gain = np.concatenate(
            [
                self.free_yaw_rate[:n],
                self.free_deviation[:n],
                zeros,
                end_free - end_bound,
                -end_free - end_bound,
                -self.max_yaw_acceleration * ones,
                -self.max_yaw_acceleration * ones,
            ]
        )
        box = np.repeat(
            [
                self.reward.yaw_rate_weight,
                self.reward.deviation_weight / self.reward.average_deviation,
                self.reward.acceleration_weight,
            ],
            n,
        )
        num_unboxed = gain.size - box.size
        lower = np.concatenate([-box, np.zeros(num_unboxed)])
        upper = np.concatenate([box, np.full(num_unboxed, np.inf)])
        result = linprog(
            -gain,
            A_eq=columns,
            b_eq=zeros,
            bounds=np.column_stack([lower, upper]),
            method="highs-ds",
            # There is nothing for presolve to remove; it takes longer than the pivots.
            options={"presolve": False},
        )
        if result.status == _LINPROG_UNBOUNDED:
            return math.inf, np.empty(0)
        if result.status != _LINPROG_OPTIMAL:
            raise RuntimeError(f"no optimum of {n} steps: {result.message}")
        limit = self.max_yaw_acceleration
        return -float(result.fun), np.clip(result.eqlin.marginals, -limit, limit)

    def first_completion(self, yaw_acceleration: FloatArray) -> int:
        """The number of steps after which the actions (N,) first complete; N if not before."""
        n = yaw_acceleration.size
        for num_steps in range(1, n):
            free, response, bound = self._terminal_rows(num_steps)
            end = free + response @ yaw_acceleration[:num_steps]
            if np.all(np.abs(end) <= bound + _COMPLETION_SLACK):
                return num_steps
        return n

    def _terminal_rows(self, num_steps: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The B bounded quantities at step N: free value (B,), response (B, N), bound (B,)."""
        end = num_steps - 1
        free = [self.free_deviation[end]]
        response = [self.deviation_response[end, :num_steps]]
        bound = [self.completion.max_deviation]
        if self.completion.max_lateral_speed is not None:
            free.append(self.speed[end] * self.free_yaw[end])
            response.append(self.speed[end] * self.yaw_response[end, :num_steps])
            bound.append(self.completion.max_lateral_speed)
        if self.completion.max_yaw_rate is not None:
            free.append(self.free_yaw_rate[end])
            response.append(self.yaw_rate_response[end, :num_steps])
            bound.append(self.completion.max_yaw_rate)
        return np.array(free), np.array(response), np.array(bound)


def _checked_profiles(
    speed: npt.ArrayLike, curvature: npt.ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Speed [m/s] and curvature [1/m], each (K,) float64, or a ValueError."""
    speeds = np.asarray(speed, dtype=np.float64)
    if speeds.ndim != 1 or speeds.size == 0:
        raise ValueError(f"speed has shape {speeds.shape}; it must be (K,), at least one step")
    curvatures = np.asarray(curvature, dtype=np.float64)
    if curvatures.shape not in ((), speeds.shape):
        raise ValueError(
            f"curvature has shape {curvatures.shape}; it must be a number or {speeds.shape}"
        )
    curvatures = np.broadcast_to(curvatures, speeds.shape)
    for k in range(speeds.size):
        if not (np.isfinite(speeds[k]) and speeds[k] >= 0.0):
            raise ValueError(
                f"speed[{k}] is {float(speeds[k])!r}; it must be finite and not negative"
            )
        if not np.isfinite(curvatures[k]):
            raise ValueError(f"curvature[{k}] is {float(curvatures[k])!r}; it must be finite")
    return speeds, curvatures
