"""Cross-play: every lane changer against every kind of follower, on the same seeded traffic."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from marl_lanes.envs.followers import find_policies
from marl_lanes.evaluation.driving import Policy
from marl_lanes.evaluation.intervals import CONFIDENCE, NUM_RESAMPLES, Estimate, estimate_mean
from marl_lanes.evaluation.measures import measure
from marl_lanes.evaluation.metrics import AVERAGES, summarise
from marl_lanes.evaluation.rollout import Maneuver, check_episodes, run_maneuvers
from marl_lanes.scenario import Scenario, load_scenario
from marl_lanes.traffic.roles.external import FollowerPolicy, choose_policies

RATES = (
    "success_rate",
    "completion_rate",
    "lost_after_rate",
    "collided_after_rate",
    "left_lane_after_rate",
    "abort_rate",
    "missed_rate",
    "abort_or_miss_rate",
    "timed_out_rate",
    "horizon_rate",
    "collision_rate",
    "off_road_rate",
    "s_critical_violation_rate",
    "rss_violation_rate_leader",
    "rss_violation_rate_follower",
    "critical_time_to_collision_rate",
    "braking_reaches_2_rate",
    "braking_reaches_4_rate",
    "braking_reaches_8_rate",
)
MEANS = (
    "mean_time_to_completion",
    "mean_marking_duration",
    "mean_max_follower_braking_all",
    "mean_imposed_on_follower",
    "mean_imposed_on_changer",
    "mean_drac",
    "mean_time_exposed",
    "mean_time_integrated",
    "mean_post_encroachment_time_follower",
    "mean_post_encroachment_time_leader",
    "mean_time_headway_follower",
    "mean_time_headway_leader",
    "mean_peak_longitudinal_jerk",
    "mean_peak_total_lateral_acceleration",
)
EXTREMES = ("max_follower_braking_all", "max_drac", "min_time_to_collision")
"""The statistics of a pair, as defined in docs/metrics.md; the extremes have no interval."""


@dataclass(frozen=True)
class Pair:
    """A lane changer and a kind of follower, with their maneuvers."""

    changer: str
    followers: str
    scenario: Scenario
    maneuvers: list[Maneuver]


def crossplay(
    changers: Mapping[str, tuple[Scenario, Policy]],
    followers: Mapping[str, Mapping[str, Any]],
    num_maneuvers: int,
    *,
    seed: int = 0,
    follower_policies: Mapping[str, FollowerPolicy] | None = None,
    progress: Callable[[int], object] | None = None,
) -> dict[str, Any]:
    """Run every changer against every kind of follower and estimate the statistics of each pair.

    Every pair runs on the changer's scenario with its section ``followers`` overridden, from
    the same seed: changers of one scenario meet the same vehicles until they act differently. A
    policy with a state, such as the random one, keeps it from pair to pair.

    Args:
        changers: label to scenario and policy, observations (N, F) to actions (N, D).
        followers: label to the overrides of ``scenario.followers``, for example
            ``{"mix": {"adversarial": 1.0}}`` or
            ``{"mix": {"learned": 1.0}, "learned": {"checkpoint": "follower.pt"}}``.
        num_maneuvers: of each pair, >= 1.
        seed: of the traffic and of the resamples.
        follower_policies: by disposition; they have priority over registered and saved ones.
        progress: called after every step with the number of finished maneuvers, out of
            ``len(changers) * len(followers) * num_maneuvers``.

    Returns:
        ``num_maneuvers``, ``seed``, ``confidence``, ``num_resamples``, ``changers`` (label to
        scenario name), ``followers`` (label to override) and ``pairs``: a list, by changer, then
        by follower, of ``changer``, ``scenario``, ``followers`` (both labels), ``num_maneuvers``,
        ``num_roads`` and ``statistics``, which maps each of RATES, MEANS and EXTREMES to ``value``,
        ``low`` and ``high``. All values can be written as JSON.

    Raises:
        ScenarioError: a scenario is invalid, its episodes have no end, or a follower has no
            policy. This and every other error in the arguments comes before the simulation starts.
        CheckpointError: a follower's checkpoint cannot be read or does not fit.
        ValueError: another argument is out of range.
    """
    pairs = [
        describe_pair(pair, seed=seed)
        for pair in drive_pairs(
            changers,
            followers,
            num_maneuvers,
            seed=seed,
            follower_policies=follower_policies,
            progress=progress,
        )
    ]
    names = {label: scenario.name for label, (scenario, _) in changers.items()}
    return compose_result(names, followers, pairs, num_maneuvers, seed)


def compose_result(
    changers: Mapping[str, str],
    followers: Mapping[str, Mapping[str, Any]],
    pairs: Sequence[Mapping[str, Any]],
    num_maneuvers: int,
    seed: int,
) -> dict[str, Any]:
    """The result of ``crossplay`` from its parts.

    Args:
        changers: label to scenario name.
        followers: label to overrides, as for ``crossplay``.
        pairs: of ``describe_pair``.
        num_maneuvers: of each pair.
        seed: of the traffic and of the resamples.
    """
    return {
        "num_maneuvers": num_maneuvers,
        "seed": seed,
        "confidence": CONFIDENCE,
        "num_resamples": NUM_RESAMPLES,
        "changers": dict(changers),
        "followers": {label: dict(override) for label, override in followers.items()},
        "pairs": list(pairs),
    }


def describe_pair(pair: Pair, *, seed: int) -> dict[str, Any]:
    """An entry of ``pairs`` in the result of ``crossplay``.

    Args:
        pair: that has driven.
        seed: of the resamples.
    """
    return {
        "changer": pair.changer,
        "scenario": pair.scenario.name,
        "followers": pair.followers,
        "num_maneuvers": len(pair.maneuvers),
        "num_roads": len({maneuver.env for maneuver in pair.maneuvers}),
        "statistics": estimate(pair.maneuvers, pair.scenario, seed=seed),
    }


def drive_pairs(
    changers: Mapping[str, tuple[Scenario, Policy]],
    followers: Mapping[str, Mapping[str, Any]],
    num_maneuvers: int,
    *,
    seed: int = 0,
    follower_policies: Mapping[str, FollowerPolicy] | None = None,
    progress: Callable[[int], object] | None = None,
) -> Iterator[Pair]:
    """The maneuvers of every pair, one pair at a time; arguments and errors as in ``crossplay``.

    Every scenario and follower is checked before the first pair runs.
    """
    if num_maneuvers < 1:
        raise ValueError(f"num_maneuvers = {num_maneuvers}: must be at least 1")
    for name, given in (("changers", changers), ("followers", followers)):
        if not given:
            raise ValueError(f"{name}: must have at least one entry")
    prepared = []
    for changer, (scenario, policy) in changers.items():
        for label, override in followers.items():
            loaded = load_scenario(scenario, {"followers": override})
            check_episodes(loaded)
            drivers = find_policies(loaded, follower_policies)
            choose_policies(loaded, drivers, has_learner=False)  # rejects one without a policy
            prepared.append((changer, label, loaded, policy, drivers))
    for number, (changer, label, loaded, policy, drivers) in enumerate(prepared):

        def show(count: int, before: int = number * num_maneuvers) -> None:
            if progress is not None:
                progress(before + min(count, num_maneuvers))

        maneuvers = run_maneuvers(
            loaded, policy, num_maneuvers, seed=seed, follower_policies=drivers, progress=show
        )
        yield Pair(changer, label, loaded, maneuvers)


def estimate(
    maneuvers: Sequence[Maneuver], scenario: Scenario, *, seed: int = 0
) -> dict[str, dict[str, float | None]]:
    """The statistics of RATES, MEANS and EXTREMES, each as ``value``, ``low`` and ``high``."""
    measured = [measure(maneuver, scenario, with_optimum=False) for maneuver in maneuvers]
    roads = [maneuver.env for maneuver in maneuvers]
    summary = summarise(measured)
    found = {
        key: estimate_mean(
            [AVERAGES[key](row) for row in measured], roads, is_rate=key in RATES, seed=seed
        )
        for key in (*RATES, *MEANS)
    }
    found |= {key: Estimate(summary[key], None, None) for key in EXTREMES}
    return {key: asdict(value) for key, value in found.items()}
