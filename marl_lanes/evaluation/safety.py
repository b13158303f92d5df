"""Surrogate safety measures of one maneuver; docs/metrics.md gives every formula and source."""

from dataclasses import dataclass
from math import inf, nan
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from marl_lanes.scenario import Scenario
from marl_lanes.traffic.machine.state import Phase

CRITICAL_TIME_TO_COLLISION = 1.5
"""TTC* [s] of TET and TIT."""
S_CRITICAL_REACTION_TIME = 0.4
"""t_B [s], UN R79."""
S_CRITICAL_DECELERATION = 3.0
"""a [m/s^2], UN R79."""
S_CRITICAL_TIME_GAP = 1.0
"""t_G [s], UN R79."""
RSS_RESPONSE_TIME = 1.0
"""rho [s]."""
RSS_MAX_ACCELERATION = 3.5
"""a_max [m/s^2], largest acceleration of the vehicle behind during the response time."""
RSS_MIN_BRAKING = 4.0
"""b_min [m/s^2], smallest braking of the vehicle behind afterwards."""
RSS_MAX_BRAKING = 8.0
"""b_max [m/s^2], largest braking of the vehicle ahead."""

Columns = NDArray[np.float64]


@dataclass(frozen=True)
class SafetyMetrics:
    """Safety measures of one maneuver; nan if not defined."""

    min_time_to_collision: float
    """The smallest of the next four [s]; all are inf if no gap closes."""
    min_time_to_collision_target_leader: float
    min_time_to_collision_target_follower: float
    min_time_to_collision_origin_leader: float
    min_time_to_collision_origin_follower: float
    time_exposed: float
    """TET [s]."""
    time_integrated: float
    """TIT [s^2]."""
    drac: float
    imposed_on_follower: float
    imposed_on_changer: float
    post_encroachment_time_leader: float
    post_encroachment_time_follower: float
    time_headway_leader: float
    time_headway_follower: float
    is_s_critical_violated: float
    is_rss_violated_leader: float
    is_rss_violated_follower: float
    rss_violation_time: float
    marking_duration: float
    """Lane change maneuver as in UN R79 [s]."""
    follower_braking_before_marking: float
    follower_braking_after_marking: float
    changer_braking_before_marking: float
    changer_braking_after_marking: float


class _Pair(NamedTuple):
    """Two vehicles, one behind the other, and the rows that count."""

    gap: Columns
    rear_speed: Columns
    front_speed: Columns
    counts: NDArray[np.bool_]


def measure_safety(trace: NDArray[np.void], scenario: Scenario) -> SafetyMetrics:
    """Every measure of one maneuver from its (N,) TRACE."""
    step = scenario.time_step
    pairs = _pairs(trace)
    times = {name: _time_to_collision(pair) for name, pair in pairs.items()}
    smallest = {name: float(values.min(initial=inf)) for name, values in times.items()}
    soonest = np.minimum.reduce(list(times.values()))
    missing = np.maximum(0.0, CRITICAL_TIME_TO_COLLISION - soonest)
    entry = entry_row(trace)
    has_rows = bool(len(trace))
    rss = {
        side: _is_rss_violated(pairs[f"target_{side}"], trace) for side in ("leader", "follower")
    }
    is_violated = np.logical_or.reduce([violated for violated, _ in rss.values()])
    is_rss_defined = any(present.any() for _, present in rss.values())
    attempt = trace if entry is None else _attempt(trace, entry)
    at = None if entry is None else int(np.flatnonzero(attempt["step"] == trace["step"][entry])[0])
    # The step that brings the body over the marking counts as before it.
    last = len(trace) if entry is None else entry + 1
    before, after = slice(0, last), slice(last, None)
    return SafetyMetrics(
        min_time_to_collision=min(smallest.values()),
        **{f"min_time_to_collision_{name}": value for name, value in smallest.items()},
        time_exposed=float((missing > 0.0).sum() * step) if has_rows else nan,
        time_integrated=float(missing.sum() * step) if has_rows else nan,
        drac=max(map(_drac, pairs.values())) if has_rows else nan,
        imposed_on_follower=_largest(trace["imposed_on_follower"]),
        imposed_on_changer=_largest(trace["imposed_on_changer"]),
        post_encroachment_time_leader=_time_behind_leader(attempt, at, step),
        post_encroachment_time_follower=_time_ahead_of_follower(attempt, at, step),
        time_headway_leader=_headway(pairs["target_leader"], entry, trace["leader_length"]),
        time_headway_follower=_headway(pairs["target_follower"], entry, trace["length"]),
        is_s_critical_violated=_is_s_critical_violated(trace, entry),
        **{
            f"is_rss_violated_{side}": float(violated.any()) if present.any() else nan
            for side, (violated, present) in rss.items()
        },
        rss_violation_time=float(is_violated.sum() * step) if is_rss_defined else nan,
        marking_duration=_marking_duration(attempt, at, step),
        follower_braking_before_marking=hardest_braking(trace["follower_acceleration"][before]),
        follower_braking_after_marking=hardest_braking(trace["follower_acceleration"][after]),
        changer_braking_before_marking=hardest_braking(trace["acceleration"][before]),
        changer_braking_after_marking=hardest_braking(trace["acceleration"][after]),
    )


def attempts(trace: NDArray[np.void]) -> list[NDArray[np.void]]:
    """The trace split at the pauses, in which the agent waits."""
    return np.split(trace, np.flatnonzero(np.diff(trace["step"]) > 1) + 1)


def entry_row(trace: NDArray[np.void]) -> int | None:
    """First row with the body of an engaged changer in the target lane, None if there is none."""
    is_in = trace["is_over_marking"] & (trace["phase"] == Phase.ENGAGED)
    return int(is_in.argmax()) if is_in.any() else None


def hardest_braking(acceleration: Columns) -> float:
    """Largest braking [m/s^2], 0 if there is none, nan if no value is defined."""
    braking = -acceleration[np.isfinite(acceleration)]
    return max(0.0, float(braking.max())) if braking.size else nan


def rss_distance(rear_speed: Any, front_speed: Any) -> Any:
    """The longitudinal distance of Responsibility-Sensitive Safety [m], arrays or scalars.

    max(0, v_r rho + a_max rho^2/2 + (v_r + a_max rho)^2/(2 b_min) - v_f^2/(2 b_max)).

    Source: Shalev-Shwartz, Shammah, Shashua 2017, definition 1 (lemma 2).
    """
    fastest = rear_speed + RSS_MAX_ACCELERATION * RSS_RESPONSE_TIME
    reacting = 0.5 * (rear_speed + fastest) * RSS_RESPONSE_TIME
    braking = fastest**2 / (2.0 * RSS_MIN_BRAKING)
    return np.maximum(0.0, reacting + braking - front_speed**2 / (2.0 * RSS_MAX_BRAKING))


def _attempt(trace: NDArray[np.void], row: int) -> NDArray[np.void]:
    """The attempt that contains the row."""
    step = trace["step"][row]
    return next(part for part in attempts(trace) if part["step"][-1] >= step)


def _pairs(trace: NDArray[np.void]) -> dict[str, _Pair]:
    """The changer with each of its neighbors, by lane and side.

    Neighbors in the target lane count while the changer is engaged or its body is in that lane,
    neighbors in the origin lane as long as its body is in the origin lane.
    """
    is_toward = (trace["phase"] == Phase.ENGAGED) | trace["is_over_marking"]
    found = {}
    for lane, prefix, counts in (
        ("target", "", is_toward),
        ("origin", "origin_", trace["is_in_origin"]),
    ):
        for side in ("leader", "follower"):
            gap, speed = trace[f"{prefix}{side}_gap"], trace[f"{prefix}{side}_speed"]
            is_leader = side == "leader"
            rear, front = (trace["speed"], speed) if is_leader else (speed, trace["speed"])
            found[f"{lane}_{side}"] = _Pair(gap, rear, front, counts & np.isfinite(gap))
    return found


def _closing(pair: _Pair) -> tuple[NDArray[np.bool_], Columns, Columns]:
    """The rows in which the gap closes, with gap and closing speed in these rows."""
    closing = pair.rear_speed - pair.front_speed
    # Two vehicles side by side in two lanes have no positive gap.
    closes = pair.counts & (pair.gap > 0.0) & (closing > 0.0)
    return closes, pair.gap[closes], closing[closes]


def _time_to_collision(pair: _Pair) -> Columns:
    """gap/closing speed in every row [s], inf if the gap does not close."""
    closes, gap, closing = _closing(pair)
    times = np.full(closes.shape, inf)
    times[closes] = gap / closing
    return times


def _drac(pair: _Pair) -> float:
    """Largest closing speed^2/(2 gap) [m/s^2], 0 if no gap closes."""
    _, gap, closing = _closing(pair)
    return float((closing**2 / (2.0 * gap)).max(initial=0.0))


def _largest(values: Columns) -> float:
    defined = values[np.isfinite(values)]
    return float(defined.max()) if defined.size else nan


def _headway(pair: _Pair, entry: int | None, length: Columns) -> float:
    """Distance front to front divided by the speed of the rear vehicle, at the entry [s].

    ``length`` is that of the vehicle ahead [m].
    """
    if entry is None or not pair.counts[entry] or pair.rear_speed[entry] <= 0.0:
        return nan
    return float((pair.gap[entry] + length[entry]) / pair.rear_speed[entry])


def _is_s_critical_violated(trace: NDArray[np.void], entry: int | None) -> float:
    """Whether the follower is nearer than S_critical at the entry."""
    if entry is None or not np.isfinite(trace["follower_gap"][entry]):
        return nan
    row = trace[entry]
    closing = max(0.0, float(row["follower_speed"] - row["speed"]))
    critical = (
        closing * S_CRITICAL_REACTION_TIME
        + closing**2 / (2.0 * S_CRITICAL_DECELERATION)
        + float(row["speed"]) * S_CRITICAL_TIME_GAP
    )
    return float(row["follower_gap"] < critical)


def _is_rss_violated(
    pair: _Pair, trace: NDArray[np.void]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Rows with a gap below the RSS distance, and rows with both vehicles in the target lane."""
    present = pair.counts & trace["is_over_marking"]
    is_near = pair.gap < rss_distance(pair.rear_speed, pair.front_speed)
    return present & is_near, present


def _time_ahead_of_follower(attempt: NDArray[np.void], entry: int | None, step: float) -> float:
    """From the entry until the follower's front is where the changer's rear was at the entry [s].

    If the rows end before that, or another vehicle is then behind, the follower is extrapolated at
    its last speed.
    """
    if entry is None or not np.isfinite(attempt["follower_gap"][entry]):
        return nan
    rows = attempt[entry:]
    rows = rows[: _num_equal(rows["follower_id"])]
    rear = rows["position"] - 0.5 * rows["length"]
    place, front = rear[0], rear - rows["follower_gap"]
    return _arrival(place - front, rows["follower_speed"], step)


def _time_behind_leader(attempt: NDArray[np.void], entry: int | None, step: float) -> float:
    """From when the leader's rear was where the changer's front is at the entry, until entry [s].

    If the rows begin after that, or another vehicle was ahead then, the leader is extrapolated
    back at its first speed.
    """
    if entry is None or not np.isfinite(attempt["leader_gap"][entry]):
        return nan
    rows = attempt[entry::-1]
    rows = rows[: _num_equal(rows["leader_id"])]
    front = rows["position"] + 0.5 * rows["length"]
    place, rear = front[0], front + rows["leader_gap"]
    return _arrival(rear - place, rows["leader_speed"], step)


def _num_equal(values: NDArray[np.int64]) -> int:
    """How many values at the start are equal to the first one."""
    differs = np.flatnonzero(values != values[0])
    return int(differs[0]) if differs.size else len(values)


def _arrival(distance: Columns, speed: Columns, step: float) -> float:
    """When the distance (one value per step) reaches 0, extrapolated at the last speed [s]."""
    arrived = np.flatnonzero(distance <= 0.0)
    if not arrived.size:
        last = len(distance) - 1
        return float(last * step + distance[-1] / speed[-1]) if speed[-1] > 0.0 else nan
    row = int(arrived[0])
    if row == 0:
        return 0.0
    share = distance[row - 1] / (distance[row - 1] - distance[row])
    return float((row - 1 + share) * step)


def _marking_duration(attempt: NDArray[np.void], entry: int | None, step: float) -> float:
    """From when the body touches the marking until it has left the origin lane [s]."""
    if entry is None:
        return nan
    is_out = ~attempt["is_in_origin"][entry:]
    return float(is_out.argmax() * step) if is_out.any() else nan
