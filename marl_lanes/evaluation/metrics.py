"""Metrics of many maneuvers; docs/metrics.md gives every definition, unit and source."""

from collections.abc import Callable, Iterable, Sequence
from math import nan
from statistics import median
from typing import Any

import numpy as np

from marl_lanes.evaluation.measures import STEERING_COSTS, ManeuverMetrics, measure
from marl_lanes.evaluation.optimum import find_unminimised
from marl_lanes.evaluation.rollout import Maneuver
from marl_lanes.scenario import Scenario
from marl_lanes.traffic.machine.state import Outcome

HARD_BRAKING = (2, 4, 8)
"""[m/s^2] The shares of changes with braking of at least this are reported."""
_ROUNDING = 1e-6
"""[m/s^2] Tolerance, because braking is a difference of rounded speeds."""


def _ended_by(outcome: Outcome) -> Callable[[ManeuverMetrics], float]:
    return lambda row: float(row.outcome == outcome)


def _if_completed(name: str) -> Callable[[ManeuverMetrics], float]:
    return lambda row: float(getattr(row, name)) if row.outcome == Outcome.COMPLETED else nan


def _return_if_completed(name: str) -> Callable[[ManeuverMetrics], float]:
    return lambda row: row.returns[name] if row.outcome == Outcome.COMPLETED else nan


def _if_watched(name: str) -> Callable[[ManeuverMetrics], float]:
    return lambda row: nan if row.after is None else float(getattr(row.after, name))


def _of_safety(name: str) -> Callable[[ManeuverMetrics], float]:
    return lambda row: float(getattr(row.safety, name))


def _of_completed_safety(name: str) -> Callable[[ManeuverMetrics], float]:
    value = _of_safety(name)
    return lambda row: value(row) if row.outcome == Outcome.COMPLETED else nan


def _is_unsettled(row: ManeuverMetrics) -> float:
    return nan if row.after is None else float(np.isnan(row.after.settling_time))


def _is_critical(row: ManeuverMetrics) -> float:
    return float(row.safety.time_exposed > 0.0) if row.num_steps else nan


def _brakes(limit: float, *names: str) -> Callable[[ManeuverMetrics], float]:
    """Whether one of the decelerations of a completed maneuver reaches the limit."""

    def contribution(row: ManeuverMetrics) -> float:
        if row.outcome != Outcome.COMPLETED:
            return nan
        return float(any(getattr(row.safety, name) >= limit - _ROUNDING for name in names))

    return contribution


_COMPLETED_PEAKS = (
    "peak_yaw_acceleration",
    "peak_yaw_rate",
    "peak_lateral_acceleration",
    "peak_total_lateral_acceleration",
    "peak_lateral_jerk",
    "peak_longitudinal_jerk",
    "max_follower_braking",
    "max_changer_braking",
)
_AFTER_PEAKS = ("lateral_speed_at_completion", "peak_deviation_after", "settling_time")
_BRAKING = tuple(
    f"{who}_braking_{when}_marking"
    for who in ("follower", "changer")
    for when in ("before", "after")
)
_SAFETY_LARGEST = (
    "drac",
    "imposed_on_follower",
    "imposed_on_changer",
    "time_exposed",
    "time_integrated",
    "rss_violation_time",
)
_SAFETY_SMALLEST = (
    "post_encroachment_time_leader",
    "post_encroachment_time_follower",
    "time_headway_leader",
    "time_headway_follower",
)
_TIMES_TO_COLLISION = (
    "min_time_to_collision",
    "min_time_to_collision_target_leader",
    "min_time_to_collision_target_follower",
    "min_time_to_collision_origin_leader",
    "min_time_to_collision_origin_follower",
)

AVERAGES: dict[str, Callable[[ManeuverMetrics], float]] = {
    "success_rate": lambda row: float(row.is_success),
    "completion_rate": _ended_by(Outcome.COMPLETED),
    "success_of_completed_rate": _if_watched("is_good"),
    "lost_after_rate": _if_watched("is_lost"),
    "collided_after_rate": _if_watched("has_collided"),
    "left_lane_after_rate": _if_watched("has_left_lane"),
    "unsettled_after_rate": _is_unsettled,
    "collision_rate": _ended_by(Outcome.COLLISION),
    "steering_collision_rate": lambda row: float(row.has_side_collision),
    "abort_rate": lambda row: float(row.num_aborts > 0),
    "mean_num_aborts": lambda row: float(row.num_aborts),
    "missed_rate": _ended_by(Outcome.MISSED),
    "abort_or_miss_rate": lambda row: float(row.num_aborts > 0 or row.outcome == Outcome.MISSED),
    "off_road_rate": _ended_by(Outcome.OFF_ROAD),
    "timed_out_rate": _ended_by(Outcome.TIMED_OUT),
    "horizon_rate": _ended_by(Outcome.HORIZON),
    "mean_return": _if_completed("return_"),
    **{f"mean_return_{name}": _return_if_completed(name) for name in STEERING_COSTS},
    "mean_return_all": lambda row: row.return_,
    "mean_episode_reward": lambda row: row.episode_reward,
    "mean_optimal_return": _if_completed("optimal_return"),
    "mean_num_steps": _if_completed("num_steps"),
    "mean_duration": _if_completed("duration"),
    "mean_marking_duration": _of_completed_safety("marking_duration"),
    "mean_waiting_time": lambda row: row.waiting_time,
    "mean_time_to_completion": _if_completed("time_to_end"),
    "mean_watched_time": _if_watched("watched_time"),
    **{f"mean_{name}": _if_watched(name) for name in _AFTER_PEAKS},
    **{f"mean_{name}": _if_completed(name) for name in _COMPLETED_PEAKS},
    "mean_max_follower_braking_all": lambda row: row.max_follower_braking,
    **{f"braking_reaches_{limit}_rate": _brakes(limit, *_BRAKING) for limit in HARD_BRAKING},
    **{
        f"{name.replace('_braking_', f'_braking_reaches_{limit}_')}_rate": _brakes(limit, name)
        for limit in HARD_BRAKING
        for name in _BRAKING
    },
    "s_critical_violation_rate": _of_safety("is_s_critical_violated"),
    "rss_violation_rate_leader": _of_safety("is_rss_violated_leader"),
    "rss_violation_rate_follower": _of_safety("is_rss_violated_follower"),
    "critical_time_to_collision_rate": _is_critical,
    **{f"mean_{name}": _of_safety(name) for name in (*_SAFETY_LARGEST, *_SAFETY_SMALLEST)},
}
"""The metrics that are means over maneuvers: the value of each maneuver, nan if not defined."""


def _mean(values: Iterable[float]) -> float | None:
    finite = _finite(values)
    return float(np.mean(finite)) if finite else None


def _of_finite(choose: Callable[[Iterable[float]], float], values: Iterable[float]) -> float | None:
    finite = _finite(values)
    return choose(finite) if finite else None


def _finite(values: Iterable[float]) -> list[float]:
    return [value for value in values if np.isfinite(value)]


def summarise(
    measured: Sequence[ManeuverMetrics], *, no_optimum: str | None = None
) -> dict[str, Any]:
    """The metrics over all maneuvers, the main one first; None if no maneuver defines it.

    Args:
        measured: of every maneuver.
        no_optimum: why the maneuvers have no optimum, None if they have.
    """
    averages = {key: _mean(map(each, measured)) for key, each in AVERAGES.items()}
    optimal = averages["mean_optimal_return"]
    returns = [row.return_ for row in measured if np.isfinite(row.optimal_return)]
    # First the success rate: it says what a cost alone does not, how the vehicles end.
    summary: dict[str, Any] = {
        "num_maneuvers": len(measured),
        "success_rate": averages["success_rate"],
        "completion_rate": averages["completion_rate"],
        "cost_ratio": float(np.mean(returns)) / optimal if optimal else None,
        "no_cost_ratio": no_optimum or (None if optimal else "no maneuver was completed"),
        **averages,
    }
    for name in _COMPLETED_PEAKS:
        key = f"max_{name}".replace("max_max_", "max_")
        summary[key] = _of_finite(max, map(_if_completed(name), measured))
    for name in _AFTER_PEAKS:
        summary[f"max_{name}"] = _of_finite(max, map(_if_watched(name), measured))
    durations = map(_of_completed_safety("marking_duration"), measured)
    summary["max_marking_duration"] = _of_finite(max, durations)
    of_all = (row.max_follower_braking for row in measured)
    summary["max_follower_braking_all"] = _of_finite(max, of_all)
    for name in _SAFETY_LARGEST:
        summary[f"max_{name}"] = _of_finite(max, map(_of_safety(name), measured))
    for name in _SAFETY_SMALLEST:
        summary[f"min_{name}"] = _of_finite(min, map(_of_safety(name), measured))
    times = map(_of_safety("min_time_to_collision"), measured)
    summary["median_min_time_to_collision"] = _of_finite(median, times)
    for name in _TIMES_TO_COLLISION:
        summary[name] = _of_finite(min, map(_of_safety(name), measured))
    return summary


def evaluate(
    maneuvers: Sequence[Maneuver],
    scenario: Scenario,
    *,
    with_optimum: bool = True,
    progress: Callable[[int], object] | None = None,
) -> dict[str, Any]:
    """Measure every maneuver and average the results.

    Args:
        maneuvers: of one policy on ``scenario``.
        scenario: scenario of the maneuvers.
        with_optimum: also solve for the optimum of each completed maneuver, if the optimum
            minimises every cost of the scenario's reward.
        progress: called after each maneuver with the number measured so far.
    """
    measured, no_optimum = measure_each(
        maneuvers, scenario, with_optimum=with_optimum, progress=progress
    )
    return summarise(measured, no_optimum=no_optimum)


def measure_each(
    maneuvers: Sequence[Maneuver],
    scenario: Scenario,
    *,
    with_optimum: bool = True,
    progress: Callable[[int], object] | None = None,
) -> tuple[list[ManeuverMetrics], str | None]:
    """The metrics of each maneuver; arguments as of ``evaluate``.

    Returns:
        the metrics, in the order of the maneuvers; and why they have no optimum, None if they have.
    """
    unminimised = find_unminimised(scenario)
    no_optimum = None if with_optimum else "the optimum was not computed"
    if unminimised:
        no_optimum = f"the optimum does not minimise {', '.join(unminimised)}"
    measured = []
    for count, maneuver in enumerate(maneuvers, 1):
        measured.append(measure(maneuver, scenario, with_optimum=no_optimum is None))
        if progress is not None:
            progress(count)
    return measured, no_optimum
