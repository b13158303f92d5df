"""The cheapest lane change for a given speed profile, with which a lane changer is compared.

The cost is the reward's terms, the end the completion criterion, the motion the simulation's step.
The duration is free. Only the steering is optimized; the speed profile is that of the maneuver.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from marl_lanes.evaluation.linear_program import Program, descend
from marl_lanes.evaluation.replay import DEVIATION, LATERAL_SPEED, YAW_RATE, Replay
from marl_lanes.scenario import Scenario
from marl_lanes.traffic.parameters import make_parameters
from marl_lanes.traffic.roles.changer import CHANGER

FloatArray = npt.NDArray[np.float64]

MINIMISED = ("yaw_acceleration", "yaw_rate", "deviation")
"""The terms of the reward whose cost is minimised."""

MAX_EXTENSION = 20.0
"""[s] How much longer than the recorded maneuver the optimum may take."""

TOLERANCE = 1e-6
"""[1] Share of the cost by which another linearization may still lower it."""

_STRIDE = 3
"""Steps between the durations of the first search; local minima are wider."""

_DIP_MARGIN = 0.03
"""[1] Local minima with a larger extra cost are left out; the first linearization errs by less."""

_MARGIN = 1e-7
"""[m], [m/s], [rad/s] Margin of the final state inside the completion criterion."""

_MAX_ROUNDS = 25
"""Limit of linearizations; three or four are usual."""

_SLOW = 4.0
"""[m/s] Below it the motion is not almost linear. From 3 m/s both searches find the same."""


def find_unminimised(scenario: Scenario) -> list[str]:
    """The steering costs that the scenario's reward charges, and that are not minimised here.

    Where there is one, a maneuver's return and the optimum's are sums of different costs.
    """
    weighed = zip(CHANGER.terms, CHANGER.weights(scenario), strict=True)
    charged = [term.name for term, weight in weighed if term.is_steering_cost and weight]
    return [name for name in charged if name not in MINIMISED]


@dataclass(frozen=True, eq=False)
class Optimum:
    """The cheapest lane change.

    Args:
        total_return: the sum of its rewards, the negative of its cost [1].
        num_steps: its duration N in time steps.
        yaw_acceleration: the action of each step, (N,) float64 [rad/s^2].
        path: the vehicle before the first step and after each of them, (N + 1,) VEHICLE.
    """

    total_return: float
    num_steps: int
    yaw_acceleration: FloatArray
    path: npt.NDArray[np.void]


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

    The sum is over k = 0 ... N-1; e is the deviation, turn = c v cos(psi)/(1 - c d) the road's
    turning under the vehicle. The motion is the simulation's step, with a fixed speed as a function
    of time. The position on the road, and so the curvature at it, follows from the actions. The
    constraints are |a_k| <= max_yaw_acceleration and, at N >= 1, the completion criterion. In the
    simulation at this speed these actions complete in step N, at exactly this cost.

    For fixed N the problem is solved by linear programs around the last solution, until another
    one lowers the cost by no more than TOLERANCE. The result is proven to be a local minimum. No
    search for a better one has found any, because the motion is almost linear.

    The program requires completion only at step N, which can only lower its cost. This is valid,
    because actions that complete earlier are a candidate with a smaller N and no higher cost.

    Args:
        scenario: gives road, time step, reward, completion and bound of the action; the failure
            penalty and the terms of delay and longitudinal action are not used.
        speed: speed in each step, (K,) [m/s], K >= 1; the last value is used for later steps.
        deviation: e_0, lateral deviation from the target lane's centre, positive on the side
            from which a positive yaw leads back to it [m].
        yaw: psi_0, yaw relative to the road, positive toward the target lane [rad].
        yaw_rate: omega_0, in the same direction, with the road's turning [rad/s].
        direction: of the lane change, +1 to the left, -1 to the right; used only on curves.
        initial_speed: before the first step [m/s]; by default that of the first step.
        position: s_0, on the road [m]; used only on curves.
        lateral_position: d_0, from the road's right edge [m]; used only on curves.

    Returns:
        The optimum.

    Raises:
        ValueError: an input is empty, not finite, out of range or has a wrong shape; or no
            duration, up to MAX_EXTENSION beyond the recorded one, leads to completion.
        RuntimeError: the solver failed, or the linearization converged at no duration.

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
            f"deviation is {deviation!r} m; |yaw acceleration| <= "
            f"{scenario.action.max_yaw_acceleration!r} rad/s^2 must be able to bring it to "
            f"completion ({scenario.completion}) at the recorded speed within "
            f"{replay.speed.size} steps of {scenario.time_step!r} s"
        )
    return optimum


class _Search:
    """The search over the duration, and the linearization around its result."""

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
        """The optimum; None if no duration leads to completion."""
        found = self.search(np.empty(0), num_recorded)
        if self.replay.speed.min() < _SLOW:
            # There lane keeping turns the vehicle far around, and minima near that path are poor.
            found += self.search(np.zeros(num_recorded), num_recorded)
        return max(found, key=lambda one: one.total_return, default=None)

    def search(self, actions: FloatArray, num_recorded: int) -> list[Optimum]:
        """Local minima that are found from the path of these actions and of lane keeping after."""
        self.linearise(actions, num_recorded)
        start = num_recorded
        while math.isinf(self.cost_of(start)):
            if start == self.longest:
                return []
            start = min(self.longest, start + max(1, start // 2))
        # Far above the optimal duration the cost is flat, and the actions complete before the end.
        start = min(self.first_completion(start), start, key=self.cost_of)
        dips = self.find_dips(start)
        return [self.refine(n, beginning) for n, beginning in dips.items()]

    def find_dips(self, start: int) -> dict[int, FloatArray]:
        """Local minima of the cost over N, without those much above the lowest.

        Tries durations up to one and a half times the first guess, _STRIDE apart, then finds the
        exact minimum of each dip in single steps.
        """
        longest = start
        while True:
            longest = min(self.longest, longest + longest // 2 + 2 * _STRIDE)
            # The longest first, so that the linear motion is built only once.
            tried = list(range(longest, 0, -_STRIDE))[::-1]
            costs = [math.inf, *[self.cost_of(n) for n in tried[::-1]][::-1], math.inf]
            # Continue while the cost still falls at the longest duration.
            if longest == self.longest or costs[-2] > min(costs):
                break
        limit = (1.0 + _DIP_MARGIN) * min(costs)
        found = {}
        for n, left, cost, right in zip(tried, costs, costs[1:], costs[2:], strict=False):
            if cost <= limit and left >= cost <= right:
                floor = descend(self.cost_of, n, self.longest)
                found[floor] = self.solved[floor][1]
        return found

    def refine(self, num_steps: int, actions: FloatArray) -> Optimum:
        """The solution in the simulation near these actions and this duration."""
        best = self.converge(num_steps, actions)
        while best is None:
            # In the simulation the shortest durations may be too short; or as in ``converge``.
            if num_steps == self.longest:
                raise RuntimeError(f"{actions.size} steps: no completion in the simulation")
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
        """Linearize around the solution until the cost stays.

        None if there is no solution, or if two of them alternate: from near standstill the path of
        many turning steps is far from linear. A longer or shorter duration is found then.
        """
        for _ in range(_MAX_ROUNDS):
            cost, is_completed = self.cost_in_simulation(actions)
            self.linearise(actions, min(self.longest, num_steps + 2 * _STRIDE))
            if math.isinf(self.cost_of(num_steps)):
                return None
            gain = cost - self.cost_of(num_steps)
            if is_completed and actions.size == num_steps and gain <= TOLERANCE * cost:
                return Optimum(-cost, num_steps, actions, self.replay.path(num_steps))
            actions = self.solved[num_steps][1]
        return None

    def linearise(self, actions: FloatArray, size: int) -> None:
        """Linearize the motion of ``size`` steps: the actions, then those of lane keeping."""
        self.replay.follow(actions)
        self.replay.steer(actions.size, self.longest)
        self.resize(size)

    def resize(self, size: int) -> None:
        """Plan ``size`` steps from now on, with nothing solved yet."""
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
        """Cost of the linear program with this number of steps; infinite without a solution."""
        if num_steps > self.program.size:
            kept = self.solved
            self.resize(min(self.longest, num_steps + 2 * _STRIDE))
            self.solved = kept
        if num_steps not in self.solved:
            self.solved[num_steps] = self.program.solve(num_steps)
        return self.solved[num_steps][0]

    def first_completion(self, num_steps: int) -> int:
        """Number of the solution's steps after which the linear motion is first complete."""
        return self.program.first_completion(self.solved[num_steps][1])

    def cost_in_simulation(self, actions: FloatArray) -> tuple[float, bool]:
        """The cost of the actions in the simulation, and whether they end in completion."""
        known = self.replay.follow(actions)
        cost = (
            self.reward.yaw_acceleration_weight * np.abs(actions).sum()
            + self.reward.yaw_rate_weight * np.abs(known[YAW_RATE]).sum()
            + self.reward.deviation_weight
            * (np.abs(known[DEVIATION]) / self.reward.average_deviation).sum()
        )
        return float(cost), bool((np.abs(known[:, -1]) <= self.bounds).all())


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
