"""The gap behind a lane changer over time: the same maneuvers with different followers."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from marl_lanes.evaluation.crossplay import drive_pairs
from marl_lanes.evaluation.driving import Policy
from marl_lanes.evaluation.intervals import estimate_mean
from marl_lanes.evaluation.rollout import Maneuver
from marl_lanes.evaluation.safety import entry_row
from marl_lanes.scenario import Scenario
from marl_lanes.traffic.machine.state import NONE, Phase
from marl_lanes.traffic.roles.external import FollowerPolicy

NEAR_GAP = 30.0
"""[m] A follower is near if the gap at the engagement is below this."""
GAP_CONFIDENCE = 0.99
"""Nominal coverage of the intervals of the gaps."""


@dataclass(frozen=True)
class Attempt:
    """The first attempt of a maneuver, as long as the same vehicle is behind."""

    env: int
    trace: NDArray[np.void]
    """(N,) TRACE, N >= 1, from the first step after the engagement, without a pause."""

    @property
    def start(self) -> tuple[int, int, float]:
        """Step, follower and gap [m] of the engagement: equal if the traffic was the same."""
        row = self.trace[0]
        return int(row["step"]), int(row["follower_id"]), float(row["follower_gap_before"])

    @property
    def entry(self) -> int | None:
        """First row with the body in the target lane, None if there is none in this attempt."""
        return entry_row(self.trace)

    @property
    def abort(self) -> int | None:
        """First row in which the changer aborts, None if it does not."""
        is_aborting = self.trace["phase"] == Phase.ABORTING
        return int(is_aborting.argmax()) if is_aborting.any() else None

    @property
    def gap_at_entry(self) -> float:
        """[m], nan if the changer does not enter the lane."""
        return np.nan if self.entry is None else float(self.trace["follower_gap"][self.entry])


def first_attempt(maneuver: Maneuver) -> Attempt | None:
    """The first attempt of a maneuver; None without an engagement or a vehicle behind."""
    trace = maneuver.trace
    if not len(trace) or trace["follower_id"][0] == NONE:
        return None
    is_other = trace["follower_id"] != trace["follower_id"][0]
    is_later = trace["step"] - trace["step"][0] > np.arange(len(trace))
    breaks = np.flatnonzero(is_other | is_later)
    return Attempt(maneuver.env, trace[: breaks[0]] if breaks.size else trace)


def compare_followers(
    scenario: Scenario,
    policy: Policy,
    followers: Mapping[str, Mapping[str, Any]],
    num_maneuvers: int,
    *,
    seed: int = 0,
    maneuver: int | None = None,
    follower_policies: Mapping[str, FollowerPolicy] | None = None,
    progress: Callable[[int], object] | None = None,
) -> dict[str, Any]:
    """The gap to the target lane's follower from the engagement on, for every kind of follower.

    The disposition of an entering vehicle uses one random number with every mix. So the traffic of
    a seed is the same until a changer engages for the first time on its road, and the same maneuver
    can be shown with each kind of follower. The statistics are over the comparable engagements:
    with every kind they happen in the same step, with the same vehicle behind, nearer than
    NEAR_GAP. The gaps are over those that enter the lane with every kind.

    Args:
        scenario: its section ``followers`` is overridden.
        policy: of the lane changer.
        followers: label to the overrides of ``scenario.followers``.
        num_maneuvers: with each kind of follower, >= 1.
        seed: of the traffic and of the resamples.
        maneuver: index of the one to show, from 0, ordered by road and command. None: the first
            one that engages with a follower nearer than NEAR_GAP and the same traffic until then.
        follower_policies: by disposition; they have priority over registered and saved ones.
        progress: called after every step with the number of finished maneuvers, out of
            ``len(followers) * num_maneuvers``.

    Returns:
        ``scenario``, ``seed``, ``num_maneuvers``, ``confidence``, ``near_gap``, ``maneuver``,
        ``num_compared`` (comparable engagements), ``num_entered`` (with every kind) and
        ``followers``, by label: ``override``; ``entered_rate``, ``gap_at_entry``, ``gap_change``
        (since the engagement) and ``gap_difference`` (to the first kind, maneuver by maneuver) [m],
        each as ``value``, ``low``, ``high``; and ``shown``: ``time`` since the engagement [s],
        ``gap`` [m], ``follower_acceleration`` [m/s^2] over the step that ends at that time (None at
        time 0), ``entry_time`` and ``abort_time`` [s] (None if there is no entry or abort).

    Raises:
        ScenarioError: as for ``crossplay``, before the simulation starts.
        CheckpointError: a follower's checkpoint cannot be read or does not fit.
        ValueError: an argument is out of range, or no maneuver is the same until its engagement.
    """
    if maneuver is not None and maneuver not in range(max(1, num_maneuvers)):
        raise ValueError(f"maneuver = {maneuver}: must be 0 to {num_maneuvers - 1}")
    driven = [
        {(one.env, one.command): first_attempt(one) for one in pair.maneuvers}
        for pair in drive_pairs(
            {"": (scenario, policy)},
            followers,
            num_maneuvers,
            seed=seed,
            follower_policies=follower_policies,
            progress=progress,
        )
    ]
    # One row per maneuver: its attempt with each kind of follower; empty if one is missing.
    rows = [[attempts.get(key) for attempts in driven] for key in driven[0]]
    paired = [[one for one in row if one is not None] for row in rows]
    paired = [row if len(row) == len(followers) else [] for row in paired]
    shown = _choose(paired, maneuver)
    near = [row for row in paired if row and _is_comparable(row)]
    entered = [row for row in near if all(one.entry is not None for one in row)]
    found = {}
    for column, (label, override) in enumerate(followers.items()):
        found[label] = {
            "override": dict(override),
            **_statistics(near, entered, column, seed),
            "shown": _history(paired[shown][column], scenario.time_step),
        }
    return {
        "scenario": scenario.name,
        "seed": seed,
        "num_maneuvers": num_maneuvers,
        "confidence": GAP_CONFIDENCE,
        "near_gap": NEAR_GAP,
        "maneuver": shown,
        "num_compared": len(near),
        "num_entered": len(entered),
        "followers": found,
    }


def _is_comparable(row: Sequence[Attempt]) -> bool:
    """Whether all engage in the same step, with the same vehicle behind, near."""
    return len({one.start[:2] for one in row}) == 1 and all(one.start[2] < NEAR_GAP for one in row)


def _choose(paired: Sequence[Sequence[Attempt]], wanted: int | None) -> int:
    """The maneuver to show: the wanted one, or the first comparable one with a follower near."""
    same = [index for index, row in enumerate(paired) if len({one.start for one in row}) == 1]
    if wanted is not None:
        if wanted in same:
            return wanted
        raise ValueError(
            f"maneuver = {wanted}: must engage with a vehicle behind and the same traffic until "
            "then with every kind of follower; maneuvers that do: "
            f"{', '.join(map(str, same[:10])) or 'none'}"
        )
    for index in same:
        if paired[index][0].start[2] < NEAR_GAP:
            return index
    raise ValueError(
        f"none of {len(paired)} maneuvers engages with a follower nearer than {NEAR_GAP:g} m and "
        "the same traffic until then; use more maneuvers or another seed"
    )


def _statistics(
    near: Sequence[Sequence[Attempt]],
    entered: Sequence[Sequence[Attempt]],
    column: int,
    seed: int,
) -> dict[str, dict[str, float | None]]:
    """Statistics of the kind in ``column``, over the comparable maneuvers and those that enter."""

    def mean(
        rows: Sequence[Sequence[Attempt]], values: Sequence[float], *, is_rate: bool = False
    ) -> dict[str, float | None]:
        roads = [row[column].env for row in rows]
        found = estimate_mean(values, roads, is_rate=is_rate, confidence=GAP_CONFIDENCE, seed=seed)
        return asdict(found)

    gaps = [row[column].gap_at_entry for row in entered]
    starts = [row[column].start[2] for row in entered]
    firsts = [row[0].gap_at_entry for row in entered]
    return {
        "entered_rate": mean(
            near, [float(row[column].entry is not None) for row in near], is_rate=True
        ),
        "gap_at_entry": mean(entered, gaps),
        "gap_change": mean(entered, np.subtract(gaps, starts).tolist()),
        "gap_difference": mean(entered, np.subtract(gaps, firsts).tolist()),
    }


def _history(attempt: Attempt, time_step: float) -> dict[str, Any]:
    """The curves of one attempt; the first point is the engagement."""
    trace = attempt.trace
    moments = {"entry_time": attempt.entry, "abort_time": attempt.abort}
    return {
        "time": (np.arange(len(trace) + 1) * time_step).tolist(),
        "gap": [attempt.start[2], *trace["follower_gap"].tolist()],
        "follower_acceleration": [None, *trace["follower_acceleration"].tolist()],
        **{name: None if row is None else (row + 1) * time_step for name, row in moments.items()},
    }
