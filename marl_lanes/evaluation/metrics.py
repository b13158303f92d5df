"""Metrics of recorded maneuvers; docs/metrics.md gives every definition, unit and source."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from math import inf, nan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from marl_lanes.evaluation.optimum import optimal_lane_change
from marl_lanes.evaluation.rollout import Maneuver
from marl_lanes.scenario import Scenario
from marl_lanes.traffic.state import Outcome, Phase

S_CRITICAL_REACTION_TIME = 0.4
"""t_B [s], UN R79."""
S_CRITICAL_DECELERATION = 3.0
"""a [m/s^2], UN R79."""
S_CRITICAL_TIME_GAP = 1.0
"""t_G [s], UN R79."""
JERK_WINDOW = 0.5
"""[s] Lateral jerk is averaged over this time, UN R79."""


@dataclass(frozen=True)
class ManeuverMetrics:
    """What is measured of one maneuver; nan where it is not defined."""

    outcome: Outcome
    num_aborts: int
    has_side_collision: bool
    return_: float
    return_acceleration: float
    return_yaw_rate: float
    return_deviation: float
    episode_reward: float
    num_steps: int
    duration: float
    waiting_time: float
    time_to_end: float
    optimal_return: float
    peak_yaw_acceleration: float
    peak_yaw_rate: float
    peak_lateral_acceleration: float
    peak_lateral_jerk: float
    residual_overshoot: float
    min_time_to_collision: float
    max_follower_braking: float
    max_changer_braking: float
    is_s_critical_violated: float


def measure(
    maneuver: Maneuver, scenario: Scenario, *, with_optimum: bool = True
) -> ManeuverMetrics:
    """Every metric of one maneuver."""
    trace = maneuver.trace
    step = scenario.time_step
    turning = trace["yaw_rate"] - trace["road_turn_rate"]
    lateral_acceleration = trace["speed"] * turning
    returns = [
        float(trace[f"reward_{name}"].sum()) for name in ("acceleration", "yaw_rate", "deviation")
    ]
    is_completed = maneuver.outcome == Outcome.COMPLETED
    optimal = nan
    if is_completed and with_optimum:
        optimal = _optimal_return(maneuver, scenario)
    return ManeuverMetrics(
        outcome=maneuver.outcome,
        num_aborts=maneuver.num_aborts,
        has_side_collision=maneuver.has_side_collision,
        return_=sum(returns),
        return_acceleration=returns[0],
        return_yaw_rate=returns[1],
        return_deviation=returns[2],
        episode_reward=maneuver.episode_reward,
        num_steps=len(trace),
        duration=len(trace) * step,
        waiting_time=maneuver.waiting_time,
        time_to_end=maneuver.time_to_end,
        optimal_return=optimal,
        peak_yaw_acceleration=_peak(trace["yaw_acceleration"]),
        peak_yaw_rate=_peak(turning),
        peak_lateral_acceleration=_peak(lateral_acceleration),
        peak_lateral_jerk=_peak(_mean_jerk(lateral_acceleration, step)),
        residual_overshoot=max([0.0, *maneuver.residual_deviation]) if is_completed else nan,
        min_time_to_collision=_min_time_to_collision(trace),
        max_follower_braking=_hardest_braking(trace["follower_acceleration"]),
        max_changer_braking=_hardest_braking(trace["acceleration"]),
        is_s_critical_violated=_is_s_critical_violated(trace),
    )


def _optimal_return(maneuver: Maneuver, scenario: Scenario) -> float:
    """The optimum of the speed profile since the last engagement; aborts before it are left out."""
    trace = maneuver.trace
    aborted = np.flatnonzero(trace["phase"] == Phase.ABORTING)
    last = trace[aborted[-1] + 1 :] if aborted.size else trace
    first = last[0]
    optimum = optimal_lane_change(
        scenario,
        last["speed"],
        deviation=float(first["deviation_before"]),
        yaw=float(first["yaw_before"]),
        yaw_rate=float(first["yaw_rate_before"]),
        direction=int(first["direction"]),
        initial_speed=float(first["speed_before"]),
        position=float(first["position_before"]),
        lateral_position=float(first["lateral_position_before"]),
    )
    return optimum.total_return


def _peak(values: NDArray[np.float64]) -> float:
    finite = np.abs(values[np.isfinite(values)])
    return float(finite.max()) if finite.size else nan


def _mean_jerk(lateral_acceleration: NDArray[np.float64], step: float) -> NDArray[np.float64]:
    """Mean of the lateral jerk over JERK_WINDOW: the acceleration's change over the window."""
    window = max(1, round(JERK_WINDOW / step))
    padded = np.concatenate([np.zeros(window), lateral_acceleration])
    return np.asarray((padded[window:] - padded[:-window]) / (window * step))


def _min_time_to_collision(trace: NDArray[np.void]) -> float:
    """Smallest gap/closing speed to the target lane's leader and follower; inf if none closes."""
    smallest = inf
    for gap, closing in (
        (trace["leader_gap"], trace["speed"] - trace["leader_speed"]),
        (trace["follower_gap"], trace["follower_speed"] - trace["speed"]),
    ):
        # Side by side in two lanes there is no gap to close.
        closes = np.isfinite(gap) & (gap > 0.0) & (closing > 0.0)
        if closes.any():
            smallest = min(smallest, float((gap[closes] / closing[closes]).min()))
    return smallest


def _hardest_braking(acceleration: NDArray[np.float64]) -> float:
    braking = -acceleration[np.isfinite(acceleration)]
    return max(0.0, float(braking.max())) if braking.size else nan


def _is_s_critical_violated(trace: NDArray[np.void]) -> float:
    """Whether the follower is nearer than S_critical when the body first reaches the marking."""
    crossings = np.flatnonzero(trace["is_over_marking"])
    if not crossings.size:
        return nan
    row = trace[crossings[0]]
    if not np.isfinite(row["follower_gap"]):
        return nan
    closing = max(0.0, float(row["follower_speed"] - row["speed"]))
    critical = (
        closing * S_CRITICAL_REACTION_TIME
        + closing**2 / (2.0 * S_CRITICAL_DECELERATION)
        + float(row["speed"]) * S_CRITICAL_TIME_GAP
    )
    return float(row["follower_gap"] < critical)


def _ended_by(outcome: Outcome) -> Callable[[ManeuverMetrics], float]:
    return lambda row: float(row.outcome == outcome)


def _if_completed(name: str) -> Callable[[ManeuverMetrics], float]:
    return lambda row: float(getattr(row, name)) if row.outcome == Outcome.COMPLETED else nan


_PEAKS = (
    "peak_yaw_acceleration",
    "peak_yaw_rate",
    "peak_lateral_acceleration",
    "peak_lateral_jerk",
    "residual_overshoot",
    "max_follower_braking",
    "max_changer_braking",
)

AVERAGES: dict[str, Callable[[ManeuverMetrics], float]] = {
    "completion_rate": _ended_by(Outcome.COMPLETED),
    "collision_rate": _ended_by(Outcome.COLLISION),
    "steering_collision_rate": lambda row: float(row.has_side_collision),
    "abort_rate": lambda row: float(row.num_aborts > 0),
    "mean_num_aborts": lambda row: float(row.num_aborts),
    "missed_rate": _ended_by(Outcome.MISSED),
    "abort_or_miss_rate": lambda row: float(row.num_aborts > 0 or row.outcome == Outcome.MISSED),
    "off_road_rate": _ended_by(Outcome.OFF_ROAD),
    "horizon_rate": _ended_by(Outcome.HORIZON),
    "mean_return": _if_completed("return_"),
    "mean_return_acceleration": _if_completed("return_acceleration"),
    "mean_return_yaw_rate": _if_completed("return_yaw_rate"),
    "mean_return_deviation": _if_completed("return_deviation"),
    "mean_return_all": lambda row: row.return_,
    "mean_episode_reward": lambda row: row.episode_reward,
    "mean_optimal_return": _if_completed("optimal_return"),
    "mean_num_steps": _if_completed("num_steps"),
    "mean_duration": _if_completed("duration"),
    "mean_waiting_time": lambda row: row.waiting_time,
    "mean_time_to_completion": _if_completed("time_to_end"),
    **{f"mean_{name}": _if_completed(name) for name in _PEAKS},
    "mean_max_follower_braking_all": lambda row: row.max_follower_braking,
    "s_critical_violation_rate": lambda row: row.is_s_critical_violated,
}
"""The metrics that are means over maneuvers: what each one contributes, nan where it does not."""


def _finite(values: Iterable[float]) -> list[float]:
    return [value for value in values if np.isfinite(value)]


def summarise(measured: Sequence[ManeuverMetrics]) -> dict[str, Any]:
    """The metrics over all maneuvers; None where no maneuver defines one."""
    summary: dict[str, Any] = {"num_maneuvers": len(measured)}
    for key, contribution in AVERAGES.items():
        values = _finite(map(contribution, measured))
        summary[key] = float(np.mean(values)) if values else None
    optimal = [row for row in measured if np.isfinite(AVERAGES["mean_optimal_return"](row))]
    summary["cost_ratio"] = None
    if summary["mean_optimal_return"]:
        mean = float(np.mean([row.return_ for row in optimal]))
        summary["cost_ratio"] = mean / summary["mean_optimal_return"]
    for name in _PEAKS:
        key = f"max_{name}".replace("max_max_", "max_")
        summary[key] = max(_finite(map(_if_completed(name), measured)), default=None)
    of_all = _finite(row.max_follower_braking for row in measured)
    summary["max_follower_braking_all"] = max(of_all, default=None)
    times = _finite(row.min_time_to_collision for row in measured)
    summary["min_time_to_collision"] = min(times, default=None)
    return summary


def evaluate(
    maneuvers: Sequence[Maneuver],
    scenario: Scenario,
    *,
    with_optimum: bool = True,
    progress: Callable[[int], object] | None = None,
) -> dict[str, Any]:
    """Measure every maneuver and summarise them.

    Args:
        maneuvers: of one policy on ``scenario``.
        scenario: that they were driven on.
        with_optimum: also solve for the optimum of each completed one.
        progress: called after each maneuver with the number measured so far.
    """
    measured = []
    for count, maneuver in enumerate(maneuvers, 1):
        measured.append(measure(maneuver, scenario, with_optimum=with_optimum))
        if progress is not None:
            progress(count)
    return summarise(measured)
