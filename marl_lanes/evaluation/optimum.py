"""The cheapest lane change for a given speed profile.

It is what a lane changer is held against: the reward's own terms as the cost, the completion
criterion as the end, the simulation's own step as the motion, the duration free. Only the steering
is optimised; the speed profile is the maneuver's own.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from marl_lanes.evaluation.linear_program import Program
from marl_lanes.evaluation.replay import DEVIATION, LATERAL_SPEED, YAW_RATE, Replay
from marl_lanes.scenario import Scenario
from marl_lanes.traffic.parameters import make_parameters

FloatArray = npt.NDArray[np.float64]

MAX_EXTENSION = 20.0
"""[s] How much longer than the recorded maneuver the optimum may take."""

TOLERANCE = 1e-6
"""[1] Of the optimum's cost: what linearising the motion anew can still gain."""

_STRIDE = 3
"""Steps between the durations of the first search; a dip is wider."""

_DIP_MARGIN = 0.03
"""[1] Dips dearer by more than this are left: more than the first linearisation can be wrong."""

_MARGIN = 1e-7
"""[m], [m/s], [rad/s] By which the end lies within the completion criterion."""

_MAX_ROUNDS = 25
"""Linearisations; three or four are usual."""


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
    scenario: Scenario,
    speed: npt.ArrayLike,
    *,
    deviation: float,
    yaw: float = 0.0,
    yaw_rate: float = 0.0,
    direction: int = 1,
    initial_speed: float | None = None,
    position: float = 0.0,
    lateral_position: float = 0.0,
) -> Optimum:
    """Minimum over N and a of sum_k w_a |a_k| + w_w |omega_k+1 - turn_k+1| + w_d |e_k+1| / d_avg.

    The sum runs over k = 0 ... N-1; e is the deviation, turn = c v cos(psi)/(1 - c d) the road's
    turning under the vehicle. The motion is the simulation's step itself, with the speed profile
    held fixed over time; where the vehicle is on the road, and so the curvature that it meets,
    follows from the actions. Subject to |a_k| <= max_yaw_acceleration and, at N >= 1, to the
    completion criterion. The actions, driven in the simulation at this speed, complete in step N
    and cost what is claimed.

    For fixed N the problem is solved by linear programs around the last solution, until another
    one gains no more than TOLERANCE. The motion is so nearly linear that this is the global
    minimum in every search that was made for a better one; it is proven only to be a local one.

    The program asks for completion at step N only, which can only lower its cost. It loses nothing
    by that: what leads to an earlier completion is itself a candidate, of smaller N and no greater
    cost.

    Args:
        scenario: its road, time step, reward, completion and bound of the action; the failure
            penalty and the terms of delay and longitudinal action play no part.
        speed: speed in each step, (K,) [m/s], K >= 1; its last value goes on.
        deviation: e_0, lateral deviation from the target lane's centre, positive on the side
            from which a positive yaw leads back to it [m].
        yaw: psi_0, yaw relative to the road, positive toward the target lane [rad].
        yaw_rate: omega_0, in the same direction, the road's own turning included [rad/s].
        direction: of the lane change, +1 to the left, -1 to the right; matters on curves alone.
        initial_speed: before the first step [m/s]; by default the first step's.
        position: s_0, on the road [m]; matters on curves alone, as the next one.
        lateral_position: d_0, from the road's right edge [m].

    Returns:
        The optimum.

    Raises:
        ValueError: an input is empty, of the wrong shape, not finite or out of range; or no
            duration tried, up to MAX_EXTENSION beyond the recorded one, leads to completion.
        RuntimeError: the solver failed, or linearising did not converge.

    Source: the cost is Eq. 10, Eq. 11, Eq. 12 and Eq. 13 of the paper.
    """
    numbers = {"deviation": deviation, "yaw": yaw, "yaw_rate": yaw_rate, "position": position}
    for name, value in (numbers | {"lateral_position": lateral_position}).items():
        if not math.isfinite(value):
            raise ValueError(f"{name} is {value!r}; it must be finite")
    if direction not in (1, -1):
        raise ValueError(f"direction is {direction!r}; it must be 1 or -1")
    profile = _checked_speed(speed)
    before = float(profile[0]) if initial_speed is None else initial_speed
    if not (math.isfinite(before) and before >= 0.0):
        raise ValueError(f"initial_speed is {before!r}; it must be finite and not negative")
    num_extra = math.ceil(MAX_EXTENSION / scenario.time_step)
    replay = Replay(
        make_parameters(scenario),
        np.pad(profile, (0, num_extra), mode="edge"),
        initial_speed=before,
        position=position,
        lateral_position=lateral_position,
        yaw=yaw,
        yaw_rate=yaw_rate,
        direction=direction,
        deviation=deviation,
    )
    optimum = _Search(scenario, replay).run(profile.size)
    if optimum is None:
        raise ValueError(
            f"deviation is {deviation!r} m; it must be one that |yaw acceleration| <= "
            f"{scenario.action.max_yaw_acceleration!r} rad/s^2 can bring to "
            f"({scenario.completion}) at the recorded speed within {replay.speed.size} steps of "
            f"{scenario.time_step!r} s"
        )
    return optimum


class _Search:
    """The search over the duration, and the linearisation around its result."""

    def __init__(self, scenario: Scenario, replay: Replay) -> None:
        self.replay = replay
        self.reward, completion = scenario.reward, scenario.completion
        self.max_yaw_acceleration = scenario.action.max_yaw_acceleration
        bounds = np.full(3, np.inf)
        bounds[DEVIATION] = completion.max_deviation
        bounds[LATERAL_SPEED] = completion.max_lateral_speed or np.inf
        bounds[YAW_RATE] = completion.max_yaw_rate or np.inf
        self.bounds = bounds
        self.longest = replay.speed.size
        self.solved: dict[int, tuple[float, FloatArray]] = {}

    def run(self, num_recorded: int) -> Optimum | None:
        """The optimum; None where nothing leads to completion."""
        self.linearise(np.empty(0), num_recorded)
        start = num_recorded
        while math.isinf(self.cost_of(start)):
            if start == self.longest:
                return None
            start = min(self.longest, start + max(1, start // 2))
        # Far beyond the optimum the cost is flat, and its actions complete long before they end.
        start = min(self.first_completion(start), start, key=self.cost_of)
        dips = self.find_dips(start)
        found = [self.refine(n, actions) for n, actions in dips.items()]
        return max(found, key=lambda one: one.total_return)

    def find_dips(self, start: int) -> dict[int, FloatArray]:
        """Durations at which the cost over N has a dip, none much dearer than the cheapest.

        All durations up to half as long again as the first guess, _STRIDE apart, then the floor
        of each dip in single steps.
        """
        longest = start
        while True:
            longest = min(self.longest, longest + longest // 2 + 2 * _STRIDE)
            # The longest first: the linear motion is built once.
            tried = list(range(longest, 0, -_STRIDE))[::-1]
            costs = [math.inf, *[self.cost_of(n) for n in tried[::-1]][::-1], math.inf]
            # Not where the cost still falls at the end.
            if longest == self.longest or costs[-2] > min(costs):
                break
        limit = (1.0 + _DIP_MARGIN) * min(costs)
        found = {}
        for n, left, cost, right in zip(tried, costs, costs[1:], costs[2:], strict=False):
            if cost <= limit and left >= cost <= right:
                floor = _descend(self.cost_of, n, self.longest)
                found[floor] = self.solved[floor][1]
        return found

    def refine(self, num_steps: int, actions: FloatArray) -> Optimum:
        """The solution in the simulation near these actions, and near this duration."""
        best = self.converge(num_steps, actions)
        while best is None:
            # The shortest durations may turn out to be too short.
            if num_steps == self.longest:
                raise RuntimeError(f"{actions.size} steps: nothing completes in the simulation")
            num_steps += 1
            best = self.converge(num_steps, actions)
        tried = {best.num_steps}
        while True:
            near = {best.num_steps - 1, best.num_steps + 1} & set(range(1, self.longest + 1))
            hopeful = [n for n in sorted(near - tried) if self.cost_of(n) < -best.total_return]
            beginnings = [(n, self.solved[n][1]) for n in hopeful]
            for n, beginning in beginnings:
                tried.add(n)
                found = self.converge(n, beginning)
                if found is not None and found.total_return > best.total_return:
                    best = found
                    break
            else:
                return best

    def converge(self, num_steps: int, actions: FloatArray) -> Optimum | None:
        """Linearise around the solution until that gains nothing; None where there is none."""
        for _ in range(_MAX_ROUNDS):
            cost, is_completed = self.cost_in_simulation(actions)
            self.linearise(actions, min(self.longest, num_steps + 2 * _STRIDE))
            if math.isinf(self.cost_of(num_steps)):
                return None
            gain = cost - self.cost_of(num_steps)
            if is_completed and actions.size == num_steps and gain <= TOLERANCE * cost:
                return Optimum(-cost, num_steps, actions)
            actions = self.solved[num_steps][1]
        raise RuntimeError(f"{num_steps} steps: no convergence in {_MAX_ROUNDS} linearisations")

    def linearise(self, actions: FloatArray, size: int) -> None:
        """Take the motion of ``size`` steps near the actions, then lane keeping's, as linear."""
        self.replay.follow(actions)
        self.replay.steer(actions.size, self.longest)
        self.resize(size)

    def resize(self, size: int) -> None:
        free, response = self.replay.linearise(size)
        self.program = Program(
            free,
            response,
            bounds=self.bounds - _MARGIN,
            max_yaw_acceleration=self.max_yaw_acceleration,
            reward=self.reward,
        )
        self.solved = {}

    def cost_of(self, num_steps: int) -> float:
        """Of the linear program of so many steps; infinite where it has no solution."""
        if num_steps > self.program.size:
            kept = self.solved
            self.resize(min(self.longest, num_steps + 2 * _STRIDE))
            self.solved = kept
        if num_steps not in self.solved:
            self.solved[num_steps] = self.program.solve(num_steps)
        return self.solved[num_steps][0]

    def first_completion(self, num_steps: int) -> int:
        """After how many of the solution's steps the linear motion is first completed."""
        return self.program.first_completion(self.solved[num_steps][1])

    def cost_in_simulation(self, actions: FloatArray) -> tuple[float, bool]:
        """What the actions really cost, and whether they end in completion."""
        known = self.replay.follow(actions)
        cost = (
            self.reward.acceleration_weight * np.abs(actions).sum()
            + self.reward.yaw_rate_weight * np.abs(known[YAW_RATE]).sum()
            + self.reward.deviation_weight
            * (np.abs(known[DEVIATION]) / self.reward.average_deviation).sum()
        )
        return float(cost), bool((np.abs(known[:, -1]) <= self.bounds).all())


def _descend(cost_of: Callable[[int], float], start: int, longest: int) -> int:
    """Walk downhill to a duration from which a step either way costs no less."""
    best = start
    while True:
        # Of equal ones the shortest.
        near = [n for n in (best - 1, best, best + 1) if 1 <= n <= longest]
        cheapest = min(near, key=cost_of)
        if cost_of(cheapest) == cost_of(best) and cheapest >= best:
            return best
        best = cheapest


def _checked_speed(speed: npt.ArrayLike) -> FloatArray:
    """Speed [m/s], (K,) float64, or a ValueError."""
    speeds = np.asarray(speed, dtype=np.float64)
    if speeds.ndim != 1 or speeds.size == 0:
        raise ValueError(f"speed has shape {speeds.shape}; it must be (K,), at least one step")
    for k in range(speeds.size):
        if not (np.isfinite(speeds[k]) and speeds[k] >= 0.0):
            raise ValueError(
                f"speed[{k}] is {float(speeds[k])!r}; it must be finite and not negative"
            )
    return speeds
