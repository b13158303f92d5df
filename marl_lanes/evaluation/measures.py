"""Metrics of one maneuver; docs/metrics.md gives every definition, unit and source."""

from dataclasses import dataclass
from math import nan

import numpy as np
from numpy.typing import NDArray

from marl_lanes.evaluation.aftermath import Aftermath
from marl_lanes.evaluation.optimum import optimal_lane_change
from marl_lanes.evaluation.rollout import Maneuver
from marl_lanes.evaluation.safety import SafetyMetrics, attempts, hardest_braking, measure_safety
from marl_lanes.scenario import Scenario
from marl_lanes.traffic.machine.state import Outcome, Phase
from marl_lanes.traffic.roles.changer import CHANGER

LATERAL_JERK_WINDOW = 0.5
"""[s] Lateral jerk is averaged over this time, UN R79."""
LONGITUDINAL_JERK_WINDOW = 1.0
"""[s] Longitudinal jerk is averaged over this time, ISO 15622."""


STEERING_COSTS = tuple(term.name for term in CHANGER.terms if term.is_steering_cost)
"""The reward terms in the return of a maneuver, Eq. 13."""


@dataclass(frozen=True)
class AftermathMetrics:
    """Metrics of a vehicle in the time after completion; nan if not defined."""

    is_good: bool
    is_lost: bool
    has_collided: bool
    has_left_lane: bool
    watched_time: float
    lateral_speed_at_completion: float
    peak_deviation_after: float
    settling_time: float


@dataclass(frozen=True)
class ManeuverMetrics:
    """Metrics of one maneuver; nan if not defined."""

    outcome: Outcome
    num_aborts: int
    has_side_collision: bool
    return_: float
    returns: dict[str, float]
    """Return of each steering cost."""
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
    peak_total_lateral_acceleration: float
    peak_longitudinal_jerk: float
    max_follower_braking: float
    max_changer_braking: float
    safety: SafetyMetrics
    after: AftermathMetrics | None
    """None if the change was not completed."""

    @property
    def is_success(self) -> bool:
        """Completed, and afterwards neither lost nor in a collision nor out of its lane."""
        return self.after is not None and self.after.is_good


def measure(
    maneuver: Maneuver, scenario: Scenario, *, with_optimum: bool = True
) -> ManeuverMetrics:
    """Every metric of one maneuver."""
    trace = maneuver.trace
    step = scenario.time_step
    turning, speed = trace["turning"], trace["speed"]
    lateral_acceleration = speed * turning
    returns = {name: float(trace[f"reward_{name}"].sum()) for name in STEERING_COSTS}
    is_completed = maneuver.outcome == Outcome.COMPLETED
    optimal = nan
    if is_completed and with_optimum:
        optimal = _optimal_return(maneuver, scenario)
    return ManeuverMetrics(
        outcome=maneuver.outcome,
        num_aborts=maneuver.num_aborts,
        has_side_collision=maneuver.has_side_collision,
        return_=sum(returns.values()),
        returns=returns,
        episode_reward=maneuver.episode_reward,
        num_steps=len(trace),
        duration=len(trace) * step,
        waiting_time=maneuver.waiting_time,
        time_to_end=maneuver.time_to_end,
        optimal_return=optimal,
        peak_yaw_acceleration=_peak(trace["yaw_acceleration"]),
        peak_yaw_rate=_peak(turning),
        peak_lateral_acceleration=_peak(lateral_acceleration),
        peak_lateral_jerk=_peak_jerk(
            trace, lateral_acceleration, speed * trace["turning_before"], LATERAL_JERK_WINDOW, step
        ),
        peak_total_lateral_acceleration=_peak(speed * trace["yaw_rate"]),
        peak_longitudinal_jerk=_peak_jerk(
            trace,
            trace["acceleration"],
            trace["acceleration_before"],
            LONGITUDINAL_JERK_WINDOW,
            step,
        ),
        max_follower_braking=hardest_braking(trace["follower_acceleration"]),
        max_changer_braking=hardest_braking(trace["acceleration"]),
        safety=measure_safety(trace, scenario),
        after=None if maneuver.aftermath is None else _measure_aftermath(maneuver.aftermath, step),
    )


def _measure_aftermath(aftermath: Aftermath, step: float) -> AftermathMetrics:
    return AftermathMetrics(
        is_good=aftermath.is_good,
        is_lost=aftermath.is_lost,
        has_collided=aftermath.has_collided,
        has_left_lane=aftermath.has_left_lane,
        watched_time=aftermath.watched_time,
        lateral_speed_at_completion=abs(aftermath.lateral_speed),
        peak_deviation_after=aftermath.peak_deviation,
        settling_time=aftermath.settling_time(step),
    )


def _optimal_return(maneuver: Maneuver, scenario: Scenario) -> float:
    """Optimum for the speed profile since the last engagement, without aborts before it."""
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


def _peak_jerk(
    trace: NDArray[np.void],
    acceleration: NDArray[np.float64],
    before: NDArray[np.float64],
    duration: float,
    step: float,
) -> float:
    """Largest |mean of the jerk over ``duration``|: the acceleration's change over the window.

    Each attempt is measured separately, because nothing is recorded between two attempts. The
    acceleration ``before`` the first row of an attempt is assumed constant over the window.
    """
    window = max(1, round(duration / step))
    largest = nan
    for part in attempts(trace):
        rows = np.searchsorted(trace["step"], part["step"])
        if not rows.size:
            continue
        padded = np.concatenate([np.full(window, before[rows[0]]), acceleration[rows]])
        peak = _peak((padded[window:] - padded[:-window]) / (window * step))
        largest = float(np.fmax(largest, peak))
    return largest
