"""The benchmark: the row of numbers of a policy on a task; docs/benchmark.md has the rules."""

from collections.abc import Callable, Sequence
from importlib.metadata import version
from time import perf_counter
from typing import Self

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, model_validator

from marl_lanes.evaluation.driving import Policy
from marl_lanes.evaluation.intervals import Estimate, estimate_mean, estimate_ratio
from marl_lanes.evaluation.measures import ManeuverMetrics
from marl_lanes.evaluation.metrics import AVERAGES, measure_each
from marl_lanes.evaluation.rollout import run_maneuvers
from marl_lanes.evaluation.tasks import NUM_MANEUVERS, SEED
from marl_lanes.scenario import Scenario
from marl_lanes.traffic.machine.state import Outcome

ENDINGS = (
    "success_rate",
    "missed_rate",
    "lost_rate",
    "collided_rate",
    "left_lane_rate",
    "horizon_rate",
)
"""Shares of all commands, of how each ended; they add up to 1."""

MEANS = (
    "mean_time_to_completion",
    "mean_peak_lateral_acceleration",
    "mean_peak_lateral_jerk",
    "mean_peak_longitudinal_jerk",
    "mean_imposed_on_follower",
)
"""Metrics of docs/metrics.md."""

COST_RATIO = "cost_ratio"

NUM_AGENTS = (1, 64)
"""Agents in one call of the policy, whose time is measured."""

_MAX_CALLS = 200
_MAX_SECONDS = 1.0
"""Of calls of one size: enough calls of a network, and not too long with a slow policy."""
_NUM_PASSES = 3


class Training(BaseModel):
    """What a policy has learned from."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    scenario: str
    transitions: int
    """Steps of acting agents, those of demonstrations not counted."""
    demonstrations: int = 0
    """Transitions of another policy that it imitated at first."""
    seconds: float | None
    """Of the training without demonstrating, evaluating and saving; None: not known."""
    command: str | None
    """The command line; None: not known."""


class Row(BaseModel):
    """A policy on a task."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    policy: str
    task: str
    version: str
    """Of marl-lanes."""
    seed: int
    does_not_fit: str | None = None
    """Why the policy cannot drive on this task; then all that follows is empty."""
    num_maneuvers: int = 0
    num_roads: int = 0
    statistics: dict[str, Estimate] = {}
    """ENDINGS, the cost ratio and MEANS, each with its 95 % interval."""
    no_cost_ratio: str | None = None
    """Why there is no cost ratio, None if there is one."""
    decision_microseconds: dict[int, float] = {}
    """Time for the decision of one agent, by the number of agents in a call."""
    training: Training | None = None
    """None: without learning, or not known."""

    @model_validator(mode="after")
    def _check_keys(self) -> Self:
        wanted = set(ENDINGS) | {COST_RATIO} | set(MEANS), set(NUM_AGENTS)
        found = set(self.statistics), set(self.decision_microseconds)
        if found != (wanted if self.does_not_fit is None else (set(), set())):
            raise ValueError(
                f"statistics, decision_microseconds: must have the keys {sorted(wanted[0])}, "
                f"{sorted(wanted[1])}, or none where the policy does not fit"
            )
        return self


def find_ending(row: ManeuverMetrics) -> str:
    """How a command ended, with the ten seconds after a completed change: one of ENDINGS.

    Who collides or is lost has often left its lane, too: that counts last.
    """
    after = row.after
    if row.outcome == Outcome.OFF_ROAD or (after is not None and after.is_lost):
        return "lost_rate"
    if row.outcome == Outcome.COLLISION or (after is not None and after.has_collided):
        return "collided_rate"
    if after is not None:
        return "success_rate" if after.is_good else "left_lane_rate"
    return "missed_rate" if row.outcome == Outcome.MISSED else "horizon_rate"


def estimate(
    measured: Sequence[ManeuverMetrics], roads: Sequence[int], *, seed: int = 0
) -> dict[str, Estimate]:
    """ENDINGS, the cost ratio and MEANS with their intervals.

    Args:
        measured: the metrics of N maneuvers.
        roads: (N,) the road of each; maneuvers on one road are not independent.
        seed: of the resamples.
    """
    endings = list(map(find_ending, measured))
    found = {
        key: estimate_mean([float(one == key) for one in endings], roads, is_rate=True, seed=seed)
        for key in ENDINGS
    }
    found[COST_RATIO] = estimate_ratio(
        [row.return_ for row in measured],
        [row.optimal_return for row in measured],
        roads,
        seed=seed,
    )
    found |= {
        key: estimate_mean(list(map(AVERAGES[key], measured)), roads, is_rate=False, seed=seed)
        for key in MEANS
    }
    return found


def measure_row(
    name: str,
    task: str,
    scenario: Scenario,
    policy: Policy,
    num_maneuvers: int = NUM_MANEUVERS,
    *,
    seed: int = SEED,
    training: Training | None = None,
    progress: Callable[[int], object] | None = None,
) -> Row:
    """Drive a policy on a task and measure it.

    Args:
        name: of the policy.
        task: its name.
        scenario: of the task.
        policy: observations (N, F) to actions (N, D).
        num_maneuvers: >= 1.
        seed: of the traffic and of the resamples.
        training: of the policy.
        progress: called with the number of maneuvers that have ended or been measured so far, out
            of ``2 * num_maneuvers``.

    Raises:
        ScenarioError, CheckpointError, ValueError: as for ``run_maneuvers``.
        ValueError: the scenario has a time limit; ENDINGS has no share of commands that timed out.
    """
    if scenario.command.time_limit is not None:
        raise ValueError(
            f"command.time_limit = {scenario.command.time_limit}: must be null in a benchmark"
        )
    show = progress or (lambda _: None)
    seen: list[NDArray[np.float32]] = []

    def watched(observations: NDArray[np.float32]) -> NDArray[np.float64]:
        seen.append(observations[: NUM_AGENTS[-1]].copy())
        return policy(observations)

    maneuvers = run_maneuvers(
        scenario,
        watched,
        num_maneuvers,
        seed=seed,
        progress=lambda count: show(min(count, num_maneuvers)),
    )
    measured, no_optimum = measure_each(
        maneuvers, scenario, progress=lambda count: show(num_maneuvers + count)
    )
    roads = [maneuver.env for maneuver in maneuvers]
    statistics = estimate(measured, roads, seed=seed)
    if no_optimum is None and statistics[COST_RATIO].value is None:
        no_optimum = "no maneuver was completed"
    return Row(
        policy=name,
        task=task,
        version=version("marl-lanes"),
        seed=seed,
        num_maneuvers=len(maneuvers),
        num_roads=len(set(roads)),
        statistics=statistics,
        no_cost_ratio=no_optimum,
        decision_microseconds=time_decisions(policy, seen),
        training=training,
    )


def time_decisions(policy: Policy, seen: Sequence[NDArray[np.float32]]) -> dict[int, float]:
    """Microseconds for the decision of one agent, by the number of agents in a call.

    Measured apart from the simulation, with one thread of torch. The calls are given what the
    policy has seen on the roads, in the same order. Each is made three times, of which the fastest
    counts: what else the computer does is left out, the hard decisions are not.

    Args:
        policy: observations (N, F) to actions (N, D).
        seen: (n, F) of calls on the roads.
    """
    num_threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        return {number: _time_calls(policy, seen, number) for number in NUM_AGENTS}
    finally:
        torch.set_num_threads(num_threads)


def _time_calls(policy: Policy, seen: Sequence[NDArray[np.float32]], num_agents: int) -> float:
    # Spread over the whole of the evaluation; of too few agents some are given again.
    chosen = np.linspace(0, len(seen) - 1, _MAX_CALLS + 1).astype(int)
    calls = [np.resize(seen[index], (num_agents, seen[index].shape[1])) for index in chosen]
    policy(calls.pop(0))
    passes: list[list[float]] = []
    for _ in range(_NUM_PASSES):
        times: list[float] = []
        while len(times) < len(calls) and (passes or sum(times) < _MAX_SECONDS):
            begin = perf_counter()
            policy(calls[len(times)])
            times.append(perf_counter() - begin)
        passes.append(times)
        del calls[len(times) :]
    return float(1e6 * np.min(passes, 0).mean() / num_agents)
