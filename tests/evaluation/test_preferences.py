"""Weights learned from demonstrations, where the weights are known."""

from dataclasses import replace

import numpy as np
import pytest

from marl_lanes import load_scenario
from marl_lanes.evaluation.metrics import measure_each
from marl_lanes.evaluation.policies import make_tuned_cascade_policy
from marl_lanes.evaluation.preferences import (
    HIGHEST,
    LOWEST,
    Demonstration,
    bootstrap_weights,
    find_cone,
    find_demonstrations,
    fit_weights,
    learn_weights,
    optimise,
)
from marl_lanes.evaluation.rollout import run_maneuvers

PAPER = load_scenario("paper")
OTHER = np.array([1.0, 1.0, 0.1])
"""Not the paper's, which are 1, 0.25, 0.025."""
START = {
    "deviation": 3.75,
    "yaw": 0.0,
    "yaw_rate": 0.0,
    "direction": 1,
    "initial_speed": 20.0,
    "position": 150.0,
    "lateral_position": 5.625,
}

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def demonstrations():
    given = [Demonstration(np.zeros(3), np.full(40, v), START) for v in (12.0, 17.0, 21.0, 26.0)]
    return [replace(one, features=optimise(PAPER, one, OTHER)) for one in given]


@pytest.fixture(scope="module")
def learned(demonstrations):
    return learn_weights(PAPER, demonstrations, num_candidates=5, num_rounds=4, seed=0)


def test_other_weights_than_the_papers_are_recovered(learned):
    assert learned[0] == pytest.approx(OTHER, rel=0.25)


def test_demonstrations_identify_a_cone_that_more_of_them_make_narrower(demonstrations, learned):
    _, candidates = learned
    wide = find_cone(PAPER, demonstrations[:1], candidates[:1])
    narrow = find_cone(PAPER, demonstrations, candidates)
    assert (wide[0] <= narrow[0] + 1e-9).all()
    assert (narrow[1] <= wide[1] + 1e-9).all()
    assert (narrow[0] <= OTHER + 1e-9).all()
    assert (narrow[1] >= OTHER - 1e-9).all()
    assert (np.diff(narrow, axis=0)[0, 1:] < np.diff(wide, axis=0)[0, 1:]).all()
    # With weights inside it every demonstration is optimal, with others not.
    for weights, is_optimal in ((narrow.mean(axis=0), True), (OTHER * [1.0, 1.6, 1.0], False)):
        gaps = [one.features @ weights / (optimise(PAPER, one, weights) @ weights) - 1.0
                for one in demonstrations]  # fmt: skip
        assert (max(gaps) < 1e-4) == is_optimal


def test_what_is_never_optimal_has_no_cone(demonstrations, learned):
    worse = [replace(one, features=1.01 * one.features) for one in demonstrations]
    assert find_cone(PAPER, worse, learned[1]) is None


def test_the_fit_matches_the_features():
    """The condition of maximum entropy: what is expected is what was demonstrated."""
    generator = np.random.default_rng(0)
    candidates = generator.normal([5.0, 3.0, 40.0], [1.0, 1.0, 10.0], (4000, 8, 3))
    true = np.array([2.0, 1.0, 0.1])
    # Choices of someone who is as rational as the model says.
    shares = np.exp(-candidates @ true)
    chosen = np.array([generator.choice(8, p=row / row.sum()) for row in shares])
    is_chosen = np.arange(8) == chosen[:, np.newaxis]
    features = candidates[is_chosen]
    others = candidates[~is_chosen].reshape(4000, 7, 3)
    weights = fit_weights(features, others)
    assert weights == pytest.approx(true / 2.0, rel=0.1)
    low, high = bootstrap_weights(features[:500], others[:500], 30, 0)
    assert (low[1:] < true[1:] / 2.0).all()
    assert (high[1:] > true[1:] / 2.0).all()
    assert (high - low)[1:] == pytest.approx(0.2 * true[1:], rel=0.9)


def test_demonstrations_are_what_a_policy_drove():
    scenario = load_scenario("paper", {"num_agents": 2, "command": {"probability": 1.0}})
    maneuvers = run_maneuvers(scenario, make_tuned_cascade_policy(scenario), 4, seed=1)
    found = find_demonstrations(maneuvers, scenario)
    measured, _ = measure_each(maneuvers, scenario)
    kept = [one for one in measured if np.isfinite(one.optimal_return) and not one.num_aborts]
    assert len(found) == len(kept) > 2
    true = np.array([2.0, 0.5, 0.05])
    for one, metrics in zip(found, kept, strict=True):
        assert one.features @ true == pytest.approx(-metrics.return_)
        assert optimise(scenario, one, true) @ true == pytest.approx(-metrics.optimal_return)


def test_the_range_holds_the_papers_weights():
    for weights in (OTHER, np.array([1.0, 0.25, 0.025])):
        assert ((weights >= LOWEST) & (weights <= HIGHEST)).all()
