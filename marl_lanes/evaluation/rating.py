"""Ratings of changers and followers from their matches: Bradley-Terry by maximum likelihood."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit

from marl_lanes.evaluation.intervals import CONFIDENCE
from marl_lanes.evaluation.measures import measure
from marl_lanes.evaluation.rollout import Maneuver
from marl_lanes.scenario import Scenario
from marl_lanes.traffic.machine.state import Outcome

NUM_RESAMPLES = 999
"""Bootstrap resamples of the intervals; each is fitted anew."""
SCALE = 400.0 / np.log(10.0)
"""Points for a factor e of the odds, as in chess: 400 points are odds of 10 to 1."""


class Tally(NamedTuple):
    """Who won the maneuvers of a road."""

    changer: int
    """Successes: the change was completed in time, and was safe in the time after it."""
    follower: int
    """Missed or timed out: the changer reached the end of the road, or of its time, too early."""
    nobody: int
    """The rest: collisions, vehicles off the road or out of their lane, before completion or after
    it, and changes that the horizon ended."""


class Match(NamedTuple):
    """The maneuvers of a changer among followers of one kind."""

    changer: str
    followers: str
    roads: Sequence[Tally]
    """Of each road; road k has the same traffic in every match."""

    @property
    def total(self) -> Tally:
        """Of all roads."""
        return Tally(*(sum(road[part] for road in self.roads) for part in range(3)))


@dataclass(frozen=True)
class Rating:
    """A player's rating, and what it is made of, over all its matches."""

    player: str
    role: str
    """changer or followers."""
    rating: float
    """In points; the mean of all players is 0."""
    low: float | None
    high: float | None
    """Of the interval; None with a single road."""
    success_rate: float
    """Share of maneuvers that the changer won."""
    missed_rate: float
    """Share that the follower won."""
    nobody_rate: float
    """Share that nobody won."""


def tally(maneuvers: Iterable[Maneuver], scenario: Scenario, num_roads: int) -> list[Tally]:
    """Who won, by road, in the order of the roads.

    Args:
        maneuvers: of one pair, as from ``drive_pairs``.
        scenario: that they are on.
        num_roads: number of roads.
    """
    counts = [[0, 0, 0] for _ in range(num_roads)]
    for maneuver in maneuvers:
        winner = 2
        if measure(maneuver, scenario, with_optimum=False).is_success:
            winner = 0
        elif maneuver.outcome in (Outcome.MISSED, Outcome.TIMED_OUT):
            winner = 1
        counts[maneuver.env][winner] += 1
    return [Tally(*road) for road in counts]


def rate(matches: Sequence[Match], *, seed: int = 0) -> list[Rating]:
    """The ratings of all players: changers, then followers, each in the order of the matches.

    P(changer i wins against follower j) = 1 / (1 + exp(b_j - a_i)) with ratings a and b in nats.
    The ratings maximise the likelihood of all maneuvers. Their mean is 0. A maneuver that nobody
    wins is a loss for both, each against a player with rating 0: who rams gains nothing by it. Each
    player also has one win and one loss against rating 0, so that who never loses has a rating.

    The intervals are percentiles over resamples of the roads, drawn for all matches alike. They
    say what the number of maneuvers leaves open, and nothing of another training.

    Source: Bradley, Terry 1952, Rank analysis of incomplete block designs, Biometrika 39.

    Args:
        matches: all with the same roads.
        seed: of the resamples.

    Raises:
        ValueError: there is no match, or their numbers of roads differ.
    """
    if len({len(match.roads) for match in matches}) != 1:
        raise ValueError("matches: must be at least one, all with the same number of roads")
    changers = list(dict.fromkeys(match.changer for match in matches))
    followers = list(dict.fromkeys(match.followers for match in matches))
    one = np.array([changers.index(match.changer) for match in matches])
    other = np.array([len(changers) + followers.index(match.followers) for match in matches])
    counts = np.array([match.roads for match in matches], np.float64)
    num_players, num_roads = len(changers) + len(followers), counts.shape[1]
    fitted = _fit(counts.sum(axis=1), one, other, np.zeros(num_players))
    bounds: list[tuple[float | None, float | None]] = [(None, None)] * num_players
    if num_roads > 1:
        draws = np.random.default_rng(seed).multinomial(
            num_roads, np.full(num_roads, 1.0 / num_roads), NUM_RESAMPLES
        )
        refitted = [
            _fit(np.einsum("mrw,r->mw", counts, draw), one, other, fitted) for draw in draws
        ]
        tails = 0.5 - 0.5 * CONFIDENCE, 0.5 + 0.5 * CONFIDENCE
        low, high = SCALE * np.quantile(refitted, tails, axis=0)
        bounds = list(zip(low.tolist(), high.tolist(), strict=True))
    found = []
    for index, player in enumerate([*changers, *followers]):
        played = counts[(one == index) | (other == index)].sum(axis=(0, 1))
        found.append(
            Rating(
                player,
                "changer" if index < len(changers) else "followers",
                float(SCALE * fitted[index]),
                *bounds[index],
                *(played / played.sum()).tolist(),
            )
        )
    return found


def _fit(
    counts: NDArray[np.float64],
    one: NDArray[np.int64],
    other: NDArray[np.int64],
    start: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Ratings (P,) [nat] from (M, 3) maneuvers won by the changer, by the follower, by nobody.

    Args:
        counts: of each match.
        one: (M,) the changers' indices.
        other: (M,) the followers' indices.
        start: (P,) where the search begins.
    """
    won, lost, nobody = counts.T
    num_players = start.size
    lost_to_mean = np.ones(num_players)
    np.add.at(lost_to_mean, one, nobody)
    np.add.at(lost_to_mean, other, nobody)

    def loss(free: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        rating = free - free.mean()
        ahead = rating[one] - rating[other]
        likelihood = -(won * np.logaddexp(0.0, -ahead) + lost * np.logaddexp(0.0, ahead)).sum()
        likelihood -= np.logaddexp(0.0, -rating).sum()
        likelihood -= (lost_to_mean * np.logaddexp(0.0, rating)).sum()
        slope = won * expit(-ahead) - lost * expit(ahead)
        gradient = expit(-rating) - lost_to_mean * expit(rating)
        np.add.at(gradient, one, slope)
        np.add.at(gradient, other, -slope)
        return -likelihood, gradient.mean() - gradient

    options = {"gtol": 1e-8, "ftol": 1e-14, "maxiter": 1000}
    found = minimize(loss, start, jac=True, method="L-BFGS-B", options=options).x
    return np.asarray(found - found.mean())
