"""What went wrong in a run, for its report: failed maneuvers, warnings, where to see more."""

import shlex
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

from marl_lanes.report.run_files import REPLAYS_FOLDER, FinalManeuver, RunFiles
from marl_lanes.training.run_folder import TRAJECTORIES_FOLDER

LOW_SUCCESS = 0.95
"""Below this share of successes the report warns."""

MIN_ROADS = 20
"""Intervals over fewer roads are too narrow (docs/metrics.md)."""

_UNTRAINED = "step_000000000.pt"
"""The model saved before any transition."""

_KINDS = {
    "completed": "failed after completion",
    "collision": "collided",
    "off_road": "left the road",
    "missed": "missed",
    "timed_out": "ran out of time",
    "horizon": "cut off",
}

_DANGERS = (
    ("collision", "collided before completion"),
    ("off_road", "left the road, or stood across it, before completion"),
)


class Failure(NamedTuple):
    """A failed maneuver, and its replay relative to the run folder."""

    maneuver: FinalManeuver
    replay: str | None
    """None if its road has no replay."""


def list_failures(run: RunFiles) -> list[Failure]:
    """Every maneuver that is no success, by road and command."""
    failed = sorted(
        (one for one in run.maneuvers if not one.is_success),
        key=lambda one: (one.road, one.command),
    )
    return [
        Failure(
            one, f"{replay_of(one.road)}#command={one.command}" if one.road in run.replays else None
        )
        for one in failed
    ]


def replay_of(road: int) -> str:
    """The replay of a road, relative to the run folder."""
    return f"{REPLAYS_FOLDER}/road_{road:04d}.html"


def count_kinds(failures: Sequence[Failure]) -> list[tuple[str, int]]:
    """How many failures there are of each kind, the most frequent first."""
    kinds = Counter(_kind(failure.maneuver) for failure in failures)
    return sorted(kinds.items(), key=lambda pair: (-pair[1], pair[0]))


def _kind(maneuver: FinalManeuver) -> str:
    return _KINDS.get(maneuver.outcome, maneuver.outcome)


def find_warnings(run: RunFiles) -> list[str]:
    """What a reader must not overlook, in sentences."""
    total = run.evaluation.num_maneuvers
    failed = sum(not one.is_success for one in run.maneuvers)
    found = []
    if failed == total:
        found.append("Every lane change fails. This policy does not master the scenario.")
    elif 2 * failed > total:
        found.append(
            f"Most lane changes fail: {failed} of {total}. This policy does not master the "
            "scenario; its cost and times describe the few changes that it completes."
        )
    elif failed > (1.0 - LOW_SUCCESS) * total:
        found.append(
            f"{failed} of {total} lane changes fail, more than one in "
            f"{round(1.0 / (1.0 - LOW_SUCCESS))}. The table of failed maneuvers says how."
        )
    for outcome, words in _DANGERS:
        count = sum(one.outcome == outcome for one in run.maneuvers)
        if count:
            found.append(f"{_vehicles(count)} {words}.")
    after = sum(not one.is_success and one.outcome == "completed" for one in run.maneuvers)
    if after:
        found.append(
            f"{_vehicles(after)} completed the change and failed afterwards: lost, in a collision, "
            "or out of the lane. The completion rate counts them, the success rate does not."
        )
    if run.chosen == _UNTRAINED:
        found.append(
            "The best saved model is the untrained one: this training has improved nothing."
        )
    num_roads = len({one.road for one in run.maneuvers})
    if num_roads == 1:
        found.append(
            "All maneuvers are on one road, whose traffic they share: most numbers have no "
            "interval."
        )
    elif num_roads < MIN_ROADS:
        found.append(
            f"The maneuvers are on {num_roads} roads alone: the intervals are too narrow. Evaluate "
            f"on {MIN_ROADS} roads or more."
        )
    return found


def _vehicles(count: int) -> str:
    return "One vehicle" if count == 1 else f"{count} vehicles"


def describe_replays(run: RunFiles, road: int) -> list[str]:
    """The commands that record a road, make its replay, and write the report anew."""
    evaluation = run.evaluation
    folder = run.path
    trajectory = folder / TRAJECTORIES_FOLDER / f"road_{road:04d}.parquet"
    record = [
        *("record", str(folder / evaluation.policy)),
        *("--scenario", run.scenario),
        *("--seed", str(evaluation.seed)),
        *("--road", str(road)),
        *("--out", str(trajectory)),
    ]
    replay = ["replay", str(trajectory), "--out", str(folder / replay_of(road))]
    return [
        shlex.join(["marl-lanes", *arguments])
        for arguments in (record, replay, ["report", str(folder)])
    ]
