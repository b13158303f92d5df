"""Reward weights learned from demonstrated lane changes: inverse reinforcement learning.

The cost of a lane change is linear in its features (Eq. 10, Eq. 11, Eq. 12): the sums over its
steps of |yaw acceleration|, of |yaw rate| and of |deviation| / d_avg. Weights can be known up to
their scale only. So they are given as ratios to the weight of the yaw acceleration.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog, minimize
from scipy.special import logsumexp

from marl_lanes.evaluation.optimum import optimal_lane_change
from marl_lanes.evaluation.rollout import Maneuver
from marl_lanes.scenario import Scenario, load_scenario
from marl_lanes.traffic.machine.state import Outcome
from marl_lanes.traffic.parameters import make_parameters
from marl_lanes.traffic.road.geometry import road_turning

FloatArray = NDArray[np.float64]

WEIGHTS = ("yaw_acceleration_weight", "yaw_rate_weight", "deviation_weight")
"""The fields of the reward, in the order of the features."""

LOWEST = np.array([1.0, 1e-2, 1e-3])
HIGHEST = np.array([1.0, 1e1, 1e0])
"""The weights among which is searched, that of the yaw acceleration as the unit."""

TOLERANCE = 1e-5
"""[1] Share of its cost by which a demonstration may be beaten, and still counts as optimal."""

NEIGHBORHOOD = 2.0
"""Factor to both sides of an estimate within which the next candidates' weights are drawn."""

_PRIOR = 1e-7
"""Precision of the weights' Gaussian prior, each in units of its feature's spread: with 1e-3 the
prior, which knows nothing of the scale, moved the ratios by up to 80 % in a trial."""

_LEAST = 1e-12
"""In place of a first weight of 0."""

_MAX_ROUNDS = 60


@dataclass(frozen=True, eq=False)
class Demonstration:
    """A demonstrated lane change.

    Args:
        features: (3,) float64.
        speed: of each step, (N,) [m/s].
        start: the state before the first step, as ``optimal_lane_change`` takes it.
    """

    features: FloatArray
    speed: FloatArray
    start: dict[str, Any]


def find_demonstrations(maneuvers: Sequence[Maneuver], scenario: Scenario) -> list[Demonstration]:
    """The completed lane changes without an aborted attempt."""
    found = []
    for one in maneuvers:
        rows = one.trace
        if one.outcome != Outcome.COMPLETED or one.num_aborts:
            continue
        sums = [np.abs(rows[name]).sum() for name in ("yaw_acceleration", "turning")]
        sums.append(np.abs(rows["lateral_deviation"]).sum() / scenario.reward.average_deviation)
        first = rows[0]
        start = {
            "deviation": float(first["deviation_before"]),
            "yaw": float(first["yaw_before"]),
            "yaw_rate": float(first["yaw_rate_before"]),
            "direction": int(first["direction"]),
            "initial_speed": float(first["speed_before"]),
            "position": float(first["position_before"]),
            "lateral_position": float(first["lateral_position_before"]),
        }
        found.append(Demonstration(np.array(sums), rows["speed"].copy(), start))
    return found


def optimise(scenario: Scenario, demonstration: Demonstration, weights: FloatArray) -> FloatArray:
    """Features (3,) of the cheapest lane change with these weights, (3,), from the same start."""
    reward = dict(zip(WEIGHTS, weights.tolist(), strict=True))
    priced = load_scenario(scenario, {"reward": reward})
    start = demonstration.start
    optimum = optimal_lane_change(priced, demonstration.speed, **start)
    cars = optimum.path[1:]
    _, turn_rate = road_turning(cars, make_parameters(scenario).arcs)
    centre = start["lateral_position"] + start["direction"] * start["deviation"]
    deviation = np.abs(centre - cars["lateral_position"]) / scenario.reward.average_deviation
    return np.array(
        [
            np.abs(optimum.yaw_acceleration).sum(),
            np.abs(cars["yaw_rate"] - turn_rate).sum(),
            deviation.sum(),
        ]
    )


def draw_candidates(
    scenario: Scenario,
    demonstrations: Sequence[Demonstration],
    number: int,
    seed: int,
    *,
    low: FloatArray = LOWEST,
    high: FloatArray = HIGHEST,
    progress: Callable[[], object] | None = None,
) -> FloatArray:
    """Features of other lane changes from the same starts: the cheapest ones with drawn weights.

    Args:
        scenario: of the demonstrations.
        demonstrations: D of them.
        number: K, of each.
        seed: of the weights, the logarithms of which are uniform.
        low: lowest weights, (3,).
        high: highest weights, (3,).
        progress: called after each demonstration.

    Returns:
        (D, K, 3) float64.
    """
    generator = np.random.default_rng(seed)
    size = (len(demonstrations), number, low.size)
    drawn = np.exp(generator.uniform(np.log(low), np.log(high), size))
    found = []
    for one, rows in zip(demonstrations, drawn, strict=True):
        found.append([optimise(scenario, one, weights) for weights in rows])
        if progress is not None:
            progress()
    return np.array(found)


def fit_weights(features: FloatArray, candidates: FloatArray) -> FloatArray:
    """Maximum-entropy inverse reinforcement learning: the most likely ratios of the weights.

    A demonstration f_i among its candidates f_ik has the probability
    exp(-w f_i) / (exp(-w f_i) + sum_k exp(-w f_ik)). The w >= 0 with the highest likelihood is
    found, with a weak Gaussian prior. Without it the scale of w would be infinite where every
    demonstration is the best of its candidates.

    Args:
        features: f, (D, 3).
        candidates: (D, K, 3).

    Returns:
        w divided by its first entry, (3,), within LOWEST and HIGHEST. At one of these ends it says
        only that the weight is at least so small, or so large.

    Source: Ziebart et al. 2008; with sampled candidates Kuderer, Gulati, Burgard 2015.
    """
    difference = candidates - features[:, np.newaxis]
    spread = np.sqrt(np.square(difference).mean(axis=(0, 1)))
    spread[spread == 0.0] = 1.0
    above = difference / spread

    def loss(weights: FloatArray) -> tuple[float, FloatArray]:
        exponents = np.concatenate([np.zeros((len(above), 1)), -above @ weights], axis=1)
        total = logsumexp(exponents, axis=1, keepdims=True)
        shares = np.exp(exponents - total)[:, 1:]
        gradient = -np.einsum("dk,dkf->f", shares, above) / len(above)
        value = total.mean() + 0.5 * _PRIOR * weights @ weights
        return float(value), gradient + _PRIOR * weights

    found = minimize(loss, np.ones(3), jac=True, bounds=[(0.0, None)] * 3, method="L-BFGS-B")
    weights = found.x / spread
    return np.asarray(np.clip(weights / max(weights[0], _LEAST), LOWEST, HIGHEST))


def learn_weights(
    scenario: Scenario,
    demonstrations: Sequence[Demonstration],
    *,
    num_candidates: int,
    num_rounds: int,
    seed: int,
    progress: Callable[[], object] | None = None,
) -> tuple[FloatArray, FloatArray]:
    """``fit_weights`` with candidates that come nearer to the demonstrations round by round.

    The weights of the first candidates are drawn from the whole range, the others around the
    estimate so far. Lane changes that are much worse than the demonstrations say little.

    Args:
        scenario: of the demonstrations.
        demonstrations: D of them.
        num_candidates: of each demonstration in each round.
        num_rounds: of candidates.
        seed: of the candidates' weights.
        progress: called after each demonstration in each round.

    Returns:
        the ratios, (3,); and all candidates, (D, num_rounds num_candidates, 3).
    """
    features = np.array([one.features for one in demonstrations])
    low, high = LOWEST, HIGHEST
    drawn: list[FloatArray] = []
    for number in range(num_rounds):
        drawn.append(
            draw_candidates(
                scenario,
                demonstrations,
                num_candidates,
                seed + number,
                low=low,
                high=high,
                progress=progress,
            )
        )
        candidates = np.concatenate(drawn, axis=1)
        weights = fit_weights(features, candidates)
        low = np.maximum(weights / NEIGHBORHOOD, LOWEST)
        high = np.minimum(weights * NEIGHBORHOOD, HIGHEST)
    return weights, candidates


def bootstrap_weights(
    features: FloatArray, candidates: FloatArray, num_samples: int, seed: int
) -> FloatArray:
    """The 2.5 % and the 97.5 % quantile of ``fit_weights`` over redrawn demonstrations, (2, 3)."""
    generator = np.random.default_rng(seed)
    found = []
    for _ in range(num_samples):
        drawn = generator.integers(len(features), size=len(features))
        found.append(fit_weights(features[drawn], candidates[drawn]))
    return np.asarray(np.quantile(found, [0.025, 0.975], axis=0))


def find_cone(
    scenario: Scenario, demonstrations: Sequence[Demonstration], candidates: FloatArray
) -> FloatArray | None:
    """The ratios with which every demonstration is optimal: their smallest and largest values.

    The optimum is a vertex of a linear program and stays the same while the weights change a
    little. So optimal demonstrations identify a cone of weights, not a point: w with
    w f_i <= w f for all lane changes f from the same start. A linear program finds each extreme of
    the cone that the known f leave. Where a demonstration is beaten with these weights, the lane
    change that beats it becomes known, and the program is solved again.

    Args:
        scenario: of the demonstrations.
        demonstrations: D of them.
        candidates: known f, (D, K, 3).

    Returns:
        (2, 3) float64 within LOWEST and HIGHEST; None if with no weights all are optimal.

    Raises:
        RuntimeError: the cone is still changing after many rounds.
    """
    features = np.array([one.features for one in demonstrations])
    # w (f_i - f) <= TOLERANCE w f_i.
    cuts = ((1.0 - TOLERANCE) * features[:, np.newaxis] - candidates).reshape(-1, 3)
    bounds = np.column_stack([LOWEST, HIGHEST])
    extremes = np.ones((2, 3))
    for row, sign in enumerate((1.0, -1.0)):
        for column in (1, 2):
            goal = np.zeros(3)
            goal[column] = sign
            for _ in range(_MAX_ROUNDS):
                found = linprog(goal, A_ub=cuts, b_ub=np.zeros(len(cuts)), bounds=bounds)
                if not found.success:
                    return None
                beating = np.array([optimise(scenario, one, found.x) for one in demonstrations])
                new = (1.0 - TOLERANCE) * features - beating
                # Half of the tolerance again, so that cuts that are met exactly do not come back.
                is_beaten = new @ found.x > 0.5 * TOLERANCE * features @ found.x
                if not is_beaten.any():
                    break
                cuts = np.concatenate([cuts, new[is_beaten]])
            else:
                raise RuntimeError(f"no cone after {_MAX_ROUNDS} rounds")
            extremes[row, column] = found.x[column]
    return extremes
