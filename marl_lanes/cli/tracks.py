"""What a recording shows: one road for each policy and each kind of follower."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from marl_lanes.cli.names import label_changers, label_followers, saved_followers
from marl_lanes.cli.policies import make_policy
from marl_lanes.cli.progress import Progress

if TYPE_CHECKING:
    from marl_lanes.evaluation.driving import Policy
    from marl_lanes.scenario import Scenario
    from marl_lanes.trajectory.file import Trajectory
    from marl_lanes.trajectory.frames import Rows

RECORDED = ".parquet"
"""Suffix of a recorded trajectory among the policies."""


@dataclass(frozen=True)
class Track:
    """One recorded road, with the label that tells it from the others."""

    label: str
    trajectory: "Trajectory"
    road: int

    @property
    def rows(self) -> "Rows":
        """The road's rows."""
        return self.trajectory.rows_of(self.road)

    @property
    def file_label(self) -> str:
        """The label as a part of a file's name."""
        return _as_part_of_name(self.label)


@dataclass(frozen=True)
class _Drive:
    """A road to simulate."""

    scenario: "Scenario"
    policy: "Policy"
    name: str


def make_tracks(
    policies: Sequence[str],
    followers: Sequence[str] | None,
    *,
    scenario: str | None,
    seed: int | None,
    road: int | None,
    maneuver: int | None,
    last_time: float | None,
) -> list[Track]:
    """Read the recorded roads and drive the others; all are checked before the first one drives.

    Args:
        policies: POLICY, POLICY@SCENARIO or the file of a recorded trajectory.
        followers: kinds of followers, each with every policy; None: the scenario's.
        scenario: name or file; None: paper.
        seed: of the traffic; None: 0.
        road: its index; None: 0, or the first that is recorded.
        maneuver: index of the one that is to be shown, or None.
        last_time: where the simulation ends if the episode does not end before [s], or None.

    Returns:
        One track for each policy and kind of follower.

    Raises:
        ValueError: something does not fit; the message says what.
        OSError: a file cannot be read.
    """
    sources = _find_sources(policies, followers, scenario, seed)
    _check_maneuver(sources.values(), maneuver)
    number = 0 if road is None else road
    recorded = {
        label: Track(label, source, source.roads[0] if road is None else road)
        for label, source in sources.items()
        if not isinstance(source, _Drive)
    }
    for track in recorded.values():
        track.trajectory.rows_of(track.road)
    tracks = []
    with Progress("driving", len(sources)) as show:
        for count, (label, source) in enumerate(sources.items(), 1):
            if isinstance(source, _Drive):
                trajectory = _drive(source, 0 if seed is None else seed, number, last_time)
                tracks.append(Track(label, trajectory, number))
            else:
                tracks.append(recorded[label])
            show(count)
    return tracks


def read_inputs(
    policies: Sequence[str], followers: Sequence[str] | None, scenario: str | None
) -> list[str | None]:
    """What ``make_tracks`` would read: files, and names that are none."""
    sources = label_changers(policies, "POLICY").values()
    kinds = label_followers(followers or ())
    return [scenario, *saved_followers(kinds), *(part for source in sources for part in source)]


def _find_sources(
    policies: Sequence[str], followers: Sequence[str] | None, scenario: str | None, seed: int | None
) -> "dict[str, _Drive | Trajectory]":
    from marl_lanes.envs.followers import find_policies
    from marl_lanes.scenario import load_scenario
    from marl_lanes.traffic.roles.external import choose_policies
    from marl_lanes.trajectory.file import read_trajectory

    kinds = {"": None} if followers is None else label_followers(followers)
    sources: dict[str, _Drive | Trajectory] = {}
    labelled = label_changers(policies, "POLICY")
    is_recorded = [name.endswith(RECORDED) for name, _ in labelled.values()]
    if all(is_recorded):
        for option, value in (("--scenario", scenario), ("--seed", seed)):
            if value is not None:
                raise ValueError(f"{option} {value}: not with recorded trajectories")
    for label, (name, own_scenario) in labelled.items():
        if name.endswith(RECORDED):
            if followers is not None or own_scenario is not None:
                raise ValueError(f"{name}: is recorded: it has its followers and its scenario")
            trajectory = read_trajectory(Path(name))
            if not trajectory.roads:
                raise ValueError(f"{name}: has no rows")
            sources[label if len(policies) > 1 else trajectory.metadata.policy] = trajectory
            continue
        for kind, override in kinds.items():
            overrides: dict[str, Any] = {} if override is None else {"followers": override}
            chosen = "paper" if scenario is None else scenario
            loaded = load_scenario(own_scenario or chosen, overrides)
            parts = [label] if len(labelled) > 1 or not kind else []
            title = ", ".join([*parts, *([f"{kind} followers"] if kind else [])])
            choose_policies(loaded, find_policies(loaded), has_learner=False)
            policy = make_policy(name, loaded, 0 if seed is None else seed)
            sources[title] = _Drive(loaded, policy, name)
    _check_names(sources)
    return sources


def _check_maneuver(sources: "Iterable[_Drive | Trajectory]", maneuver: int | None) -> None:
    """Reject a maneuver that no road will have; what is recorded, or has no end, may have it."""
    numbers = [one.scenario.num_agents if isinstance(one, _Drive) else None for one in sources]
    known = [number for number in numbers if number is not None]
    if maneuver is not None and len(known) == len(numbers) and maneuver >= max(known):
        raise ValueError(f"--maneuver {maneuver}: must be 0 to {max(known) - 1}")


def _check_names(labels: Iterable[str]) -> None:
    """Reject policies whose files would have one name: one would replace the other."""
    known: dict[str, str] = {}
    for label in labels:
        other = known.setdefault(_as_part_of_name(label), label)
        if other != label:
            raise ValueError(f"{label}: its files would have the names of those of {other}")


def _as_part_of_name(label: str) -> str:
    return re.sub(r"[^\w.@+-]+", "_", label)


def _drive(source: _Drive, seed: int, road: int, last_time: float | None) -> "Trajectory":
    from marl_lanes.evaluation.recording import record_road

    return record_road(
        source.scenario,
        source.policy,
        seed=seed,
        name=source.name,
        road=road,
        last_time=last_time,
    )
