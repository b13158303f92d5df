"""The numbers that a report shows first: what each means, and its confidence interval."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import NamedTuple

from marl_lanes.evaluation.intervals import Estimate, estimate_mean, estimate_ratio
from marl_lanes.evaluation.measures import ManeuverMetrics
from marl_lanes.evaluation.metrics import AVERAGES

COST_RATIO = "cost_ratio"


class Headline(NamedTuple):
    """A metric of docs/metrics.md and how it is shown."""

    key: str
    title: str
    unit: str
    """``%`` for a rate, whose value is a share of 1."""
    decimals: int
    meaning: str
    """One sentence."""

    @property
    def is_rate(self) -> bool:
        """Whether each maneuver's value is 0 or 1."""
        return self.unit == "%"

    @property
    def factor(self) -> float:
        """From the metric's value to the one that is shown."""
        return 100.0 if self.is_rate else 1.0


HEADLINES = (
    Headline(
        "success_rate",
        "Success",
        "%",
        1,
        "Share of all commands whose lane change was completed by a vehicle that, in the ten "
        "seconds afterwards, neither left the road nor collided nor left its lane.",
    ),
    Headline(
        "completion_rate",
        "Completed",
        "%",
        1,
        "Share of all commands whose vehicle settled in the target lane, whatever happened "
        "afterwards.",
    ),
    Headline(
        COST_RATIO,
        "Cost ratio",
        "1",
        3,
        "Cost of the completed lane changes divided by that of the cheapest ones with the same "
        "speeds: 1 is the optimum, larger is worse.",
    ),
    Headline(
        "mean_time_to_completion",
        "Time to complete",
        "s",
        2,
        "Mean time from the command to completion, with the wait for a gap.",
    ),
    Headline(
        "missed_rate",
        "Missed",
        "%",
        1,
        "Share of all commands that reached the end of the road before they were completed.",
    ),
    Headline(
        "abort_rate",
        "Aborted at least once",
        "%",
        1,
        "Share of all commands that began a lane change and took it back because the gap was no "
        "longer safe; they may have completed it later.",
    ),
    Headline(
        "collision_rate",
        "Collided",
        "%",
        1,
        "Share of all commands that ended in a collision of their vehicle before completion.",
    ),
    Headline(
        "off_road_rate",
        "Off the road",
        "%",
        1,
        "Share of all commands whose vehicle left the road, or stood across it, before completion.",
    ),
    Headline(
        "timed_out_rate",
        "Timed out",
        "%",
        1,
        "Share of all commands whose time limit was over before they were completed.",
    ),
    Headline(
        "horizon_rate",
        "Cut off",
        "%",
        1,
        "Share of all commands that were not over when the episode ended.",
    ),
    Headline(
        "lost_after_rate",
        "Lost afterwards",
        "%",
        1,
        "Share of the completed lane changes whose vehicle left the road, or stood across it, in "
        "the ten seconds afterwards.",
    ),
    Headline(
        "collided_after_rate",
        "Collided afterwards",
        "%",
        1,
        "Share of the completed lane changes whose vehicle collided in the ten seconds afterwards.",
    ),
    Headline(
        "left_lane_after_rate",
        "Out of its lane afterwards",
        "%",
        1,
        "Share of the completed lane changes whose vehicle got out of its lane, or was lost, in "
        "the ten seconds afterwards.",
    ),
    Headline(
        "mean_num_steps",
        "Steps of steering",
        "steps",
        1,
        "Mean number of time steps in which a completed lane change was steered, aborted attempts "
        "included.",
    ),
    Headline(
        "mean_max_follower_braking_all",
        "Follower's hardest braking",
        "m/s²",
        2,
        "Mean over the maneuvers of the hardest braking of the vehicle behind in the target lane, "
        "for any reason.",
    ),
    Headline(
        "mean_imposed_on_follower",
        "Braking imposed on the follower",
        "m/s²",
        2,
        "Mean over the maneuvers of how much harder that vehicle braked than it would have without "
        "the lane change, at most; UN R171 allows 2\N{NO-BREAK SPACE}m/s².",
    ),
    Headline(
        "critical_time_to_collision_rate",
        "Critical time to collision",
        "%",
        1,
        "Share of the maneuvers in which the time to a collision, at unchanged speeds, fell below "
        "1.5\N{NO-BREAK SPACE}s.",
    ),
)
"""In the order of a report."""


def estimate_headlines(
    measured: Sequence[ManeuverMetrics], roads: Sequence[int]
) -> dict[str, dict[str, float | None]]:
    """Each headline's ``value`` and 95 % interval, ``low`` and ``high``; None if not defined.

    Args:
        measured: the metrics of N maneuvers.
        roads: (N,) the road of each; maneuvers on one road are not independent.
    """
    found: dict[str, Estimate] = {}
    for headline in HEADLINES:
        if headline.key == COST_RATIO:
            optimal = [row.optimal_return for row in measured]
            found[COST_RATIO] = estimate_ratio([row.return_ for row in measured], optimal, roads)
        else:
            values = list(map(AVERAGES[headline.key], measured))
            found[headline.key] = estimate_mean(values, roads, is_rate=headline.is_rate)
    return {key: asdict(value) for key, value in found.items()}
