"""One row for each maneuver: where and when it was, how it ended, and in words why it failed."""

import csv
from collections.abc import Sequence
from math import isfinite, nan
from pathlib import Path
from typing import NamedTuple

from marl_lanes.evaluation.measures import ManeuverMetrics
from marl_lanes.evaluation.rollout import Maneuver
from marl_lanes.files import replacing
from marl_lanes.scenario import Scenario
from marl_lanes.traffic.machine.state import Outcome, Phase


class Row(NamedTuple):
    """A maneuver; nan if not defined."""

    road: int
    """Index of the road within the evaluation's roads."""
    command: int
    """k of changer_k."""
    vehicle: int
    """Serial number on its road."""
    outcome: str
    is_success: int
    """1 or 0."""
    failure: str
    """What went wrong, in words; empty for a success."""
    command_time: float
    """When the command was given [s since the warm-up]."""
    end_time: float
    """When the command ended [s]."""
    failure_time: float
    """When it failed [s]; nan for a success, and for a vehicle that stayed out of its lane."""
    waiting_time: float
    """From the command to the first engagement, or to the end [s]."""
    num_aborts: int
    num_steps: int
    """Time steps in which the agent steered."""
    return_: float
    optimal_return: float
    cost_ratio: float
    max_follower_braking: float
    """[m/s^2]"""
    max_changer_braking: float
    """[m/s^2]"""


def tabulate(
    maneuvers: Sequence[Maneuver], measured: Sequence[ManeuverMetrics], scenario: Scenario
) -> list[Row]:
    """The rows of the maneuvers.

    Args:
        maneuvers: (N,) of one policy on ``scenario``.
        measured: (N,) the metrics of each.
        scenario: scenario of the maneuvers.
    """
    return [
        _row(maneuver, metrics, scenario.time_step)
        for maneuver, metrics in zip(maneuvers, measured, strict=True)
    ]


def write_maneuvers(path: Path, rows: Sequence[Row]) -> None:
    """Write the rows as CSV: the fields of ``Row``, ``return`` without its underscore."""
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(name.removesuffix("_") for name in Row._fields)
        writer.writerows([_format(cell) for cell in row] for row in rows)


def explain_failure(maneuver: Maneuver, time_step: float) -> str:
    """What a person would see go wrong, in words; empty for a success.

    Args:
        maneuver: of any outcome.
        time_step: of its scenario [s].
    """
    outcome, after = maneuver.outcome, maneuver.aftermath
    if after is not None:
        later = f"{after.watched_time:.1f} s after completion"
        if after.has_collided:
            return f"collided {later}"
        if after.is_lost:
            return f"lost {later}: left the road, or stood across it"
        return "got out of its lane after completion" if after.has_left_lane else ""
    activity = _describe_activity(maneuver, time_step)
    if outcome == Outcome.MISSED:
        return f"reached the end of the road while {activity}"
    if outcome == Outcome.COLLISION:
        kind = ", side by side" if maneuver.has_side_collision else ""
        return f"collided while {activity}{kind}"
    if outcome == Outcome.OFF_ROAD:
        return f"left the road, or stood across it, while {activity}"
    if outcome == Outcome.TIMED_OUT:
        return f"ran out of time while {activity}"
    return f"cut off by the end of the episode while {activity}"


def _describe_activity(maneuver: Maneuver, time_step: float) -> str:
    """What the changer did in the step that ended its command."""
    trace = maneuver.trace
    aborts = {0: "", 1: " after 1 abort"}.get(
        maneuver.num_aborts, f" after {maneuver.num_aborts} aborts"
    )
    if not len(trace):
        return "waiting for a gap, which never came"
    end_step = maneuver.born_step + round(maneuver.time_to_end / time_step)
    if trace["step"][-1] < end_step:
        return f"waiting for a gap{aborts}"
    if trace["phase"][-1] == Phase.ABORTING:
        return "returning to its lane"
    return f"changing lanes{aborts}"


def _row(maneuver: Maneuver, metrics: ManeuverMetrics, time_step: float) -> Row:
    after = maneuver.aftermath
    command_time = maneuver.born_step * time_step
    end_time = command_time + maneuver.time_to_end
    failure_time = nan
    if after is None:
        failure_time = end_time
    elif after.is_lost or after.has_collided:
        failure_time = end_time + after.watched_time
    return Row(
        road=maneuver.env,
        command=maneuver.command,
        vehicle=maneuver.vehicle,
        outcome=maneuver.outcome.name.lower(),
        is_success=int(metrics.is_success),
        failure=explain_failure(maneuver, time_step),
        command_time=command_time,
        end_time=end_time,
        failure_time=failure_time,
        waiting_time=maneuver.waiting_time,
        num_aborts=maneuver.num_aborts,
        num_steps=metrics.num_steps,
        return_=metrics.return_,
        optimal_return=metrics.optimal_return,
        cost_ratio=metrics.return_ / metrics.optimal_return if metrics.optimal_return else nan,
        max_follower_braking=metrics.max_follower_braking,
        max_changer_braking=metrics.max_changer_braking,
    )


def _format(value: object) -> object:
    """A cell: without the rounding errors of a multiple of the time step; empty if undefined."""
    if not isinstance(value, float):
        return value
    return f"{value:.10g}" if isfinite(value) else ""
