"""Confidence intervals against hand counts, theory, a plain bootstrap, and their own coverage."""

import math

import numpy as np
import pytest

from marl_lanes.evaluation.intervals import (
    Estimate,
    estimate_mean,
    estimate_over_seeds,
    estimate_ratio,
)


def width(found):
    return found.high - found.low


def test_two_groups_by_hand():
    """Of four equally likely resamples one has mean 0 and one mean 1."""
    found = estimate_mean([0.0, 1.0], [7, 3], is_rate=True)
    assert found == Estimate(0.5, 0.0, 1.0)
    # With 40 % coverage the tails of 30 % are outside.
    assert estimate_mean([0.0, 1.0], [7, 3], is_rate=True, confidence=0.4) == Estimate(
        0.5, 0.5, 0.5
    )


def test_the_mean_is_over_maneuvers_not_over_roads():
    values, groups = [10.0] + [0.0] * 9, [0] + [1] * 9
    found = estimate_mean(values, groups, is_rate=False)
    assert found.value == 1.0
    assert (found.low, found.high) == (0.0, 10.0)


def test_what_is_not_defined_is_left_out():
    values = [1.0, math.nan, 3.0, math.inf, math.nan]
    assert estimate_mean(values, [0, 0, 1, 1, 2], is_rate=False) == estimate_mean(
        [1.0, 3.0], [0, 1], is_rate=False
    )
    assert estimate_mean([math.nan] * 3, [0, 1, 2], is_rate=False) == Estimate(None, None, None)
    assert estimate_mean([], [], is_rate=True) == Estimate(None, None, None)


def test_one_road_has_no_interval():
    assert estimate_mean([0.0, 1.0, 1.0], [4, 4, 4], is_rate=True) == Estimate(2 / 3, None, None)


@pytest.mark.parametrize("number", [1, 10, 1000])
@pytest.mark.parametrize("confidence", [0.95, 0.99])
def test_a_rate_of_0_or_1_has_the_exact_bound(number, confidence):
    """(alpha/2)^(1/n), Clopper and Pearson; a bootstrap interval would have no width."""
    reach = (0.5 * (1.0 - confidence)) ** (1.0 / number)
    roads = np.arange(number) // 10
    none = estimate_mean(np.zeros(number), roads, is_rate=True, confidence=confidence)
    assert (none.value, none.low) == (0.0, 0.0)
    assert none.high == pytest.approx(1.0 - reach)
    every = estimate_mean(np.ones(number), roads, is_rate=True, confidence=confidence)
    assert (every.value, every.high) == (1.0, 1.0)
    assert every.low == pytest.approx(reach)


def test_equal_values_of_a_mean_have_no_width():
    assert estimate_mean([2.5] * 20, np.arange(20) // 5, is_rate=False) == Estimate(2.5, 2.5, 2.5)


def test_independent_values_have_the_width_of_theory():
    values = np.random.default_rng(5).normal(3.0, 2.0, 400)
    for confidence, quantile in ((0.95, 1.960), (0.99, 2.576)):
        found = estimate_mean(values, np.arange(400), is_rate=False, confidence=confidence)
        assert found.value == values.mean()
        error = quantile * values.std() / 20.0
        assert found.low == pytest.approx(found.value - error, abs=0.05 * error)
        assert found.high == pytest.approx(found.value + error, abs=0.05 * error)


def test_maneuvers_that_share_a_road_count_as_one():
    """Ten equal values per road count as one; resampling maneuvers gives sqrt(10) less width."""
    of_roads = np.random.default_rng(1).integers(0, 2, 60).astype(float)
    once = estimate_mean(of_roads, np.arange(60), is_rate=True)
    tenfold = estimate_mean(np.repeat(of_roads, 10), np.repeat(np.arange(60), 10), is_rate=True)
    assert tenfold == once
    apart = estimate_mean(np.repeat(of_roads, 10), np.arange(600), is_rate=True)
    assert width(tenfold) / width(apart) == pytest.approx(math.sqrt(10.0), rel=0.1)


def test_it_is_the_plain_bootstrap():
    generator = np.random.default_rng(2)
    groups = np.repeat(np.arange(25), generator.integers(1, 8, 25))
    values = generator.exponential(2.0, groups.size) + groups % 3
    found = estimate_mean(values, groups, is_rate=False)
    means = []
    for _ in range(4000):
        roads = generator.integers(0, 25, 25)
        drawn = np.concatenate([values[groups == road] for road in roads])
        means.append(drawn.mean())
    low, high = np.quantile(means, [0.025, 0.975])
    assert found.low == pytest.approx(low, abs=0.06 * (high - low))
    assert found.high == pytest.approx(high, abs=0.06 * (high - low))
    assert found.low < found.value < found.high


@pytest.mark.slow
def test_it_covers_the_truth_as_often_as_it_says():
    """Roads differ in their mean, as in traffic; the true mean is 0. About 94 % of 150 cover it."""
    generator = np.random.default_rng(0)
    roads = np.repeat(np.arange(60), 5)
    hits = 0
    for _ in range(150):
        values = generator.normal(0.0, 1.0, 60)[roads] + generator.normal(0.0, 1.0, 300)
        found = estimate_mean(values, roads, is_rate=False)
        hits += found.low <= 0.0 <= found.high
    assert 132 <= hits <= 149


def test_a_seed_gives_the_same_interval():
    values, roads = np.random.default_rng(4).normal(size=50), np.arange(50) // 2
    first, again, other = (
        estimate_mean(values, roads, is_rate=False, seed=seed) for seed in (1, 1, 2)
    )
    assert first == again != other
    assert other.low == pytest.approx(first.low, abs=0.1 * width(first))


@pytest.mark.parametrize(
    ("arguments", "options", "message"),
    [
        (([1.0, 2.0], [0]), {"is_rate": False}, r"shape \(2,\), groups: shape \(1,\)"),
        (([[1.0]], [[0]]), {"is_rate": False}, r"both must be \(N,\)"),
        (([1.0], [0]), {"is_rate": False, "confidence": 1.0}, r"confidence = 1.0: must be between"),
        (([0.0, 0.5], [0, 1]), {"is_rate": True}, "of a rate must be 0 or 1"),
    ],
)
def test_refused_input(arguments, options, message):
    with pytest.raises(ValueError, match=message):
        estimate_mean(*arguments, **options)


def test_a_ratio_by_hand():
    """Two roads: of four equally likely resamples one is the first road twice, one the second."""
    found = estimate_ratio([2.0, 4.0, 9.0], [1.0, 1.0, 3.0], [5, 5, 6])
    assert found == Estimate(3.0, 3.0, 3.0)
    found = estimate_ratio([-2.0, -4.0, -8.0], [-1.0, -1.0, -2.0], [5, 5, 6])
    assert (found.value, found.low, found.high) == (3.5, 3.0, 4.0)


def test_a_ratio_with_denominators_of_1_is_a_mean():
    values = np.random.default_rng(1).normal(size=60)
    roads = np.arange(60) // 6
    assert estimate_ratio(values, np.ones(60), roads, seed=4) == estimate_mean(
        values, roads, is_rate=False, seed=4
    )


def test_a_ratio_leaves_out_what_is_not_defined():
    found = estimate_ratio([1.0, math.nan, 3.0, 5.0], [1.0, 1.0, 1.0, math.inf], [0, 0, 1, 1])
    assert found == estimate_ratio([1.0, 3.0], [1.0, 1.0], [0, 1])
    assert estimate_ratio([1.0], [math.nan], [0]) == Estimate(None, None, None)
    assert estimate_ratio([], [], []) == Estimate(None, None, None)
    assert estimate_ratio([1.0, 3.0], [1.0, 1.0], [2, 2]) == Estimate(2.0, None, None)


def of_seed(values, roads):
    return values, np.ones(len(values)), roads


def test_an_interval_is_wider_where_the_trainings_differ():
    generator = np.random.default_rng(0)
    roads = np.repeat(np.arange(50), 4)
    noise = generator.normal(size=(3, 200))
    one = estimate_over_seeds([of_seed(part + 5.0, roads) for part in noise])
    means = zip(noise, (3.0, 5.0, 7.0), strict=True)
    other = estimate_over_seeds([of_seed(part + mean, roads) for part, mean in means])
    assert one.value == pytest.approx(5.0, abs=0.2)
    assert other.value == pytest.approx(one.value)
    # Of 600 values without a common cause: 1.96 / sqrt(600) on each side.
    assert 0.1 < one.high - one.low < 0.3
    assert other.low < 4.0 < 6.0 < other.high


def test_over_trainings_roads_are_drawn_whole_and_undefined_values_left_out():
    values, roads = np.repeat([0.0, 10.0], 100), np.repeat([0, 1], 100)
    assert estimate_over_seeds([of_seed(values, roads)]) == Estimate(5.0, 0.0, 10.0)
    assert estimate_over_seeds([of_seed([1.0, 3.0, np.nan], [0, 1, 2])]).value == 2.0
    ratio = [([-6.0, -3.0, -1.0], [-4.0, -2.0, np.nan], [0, 1, 2])] * 2
    assert estimate_over_seeds(ratio) == Estimate(1.5, 1.5, 1.5)
    assert estimate_over_seeds([of_seed([1.0, 2.0], [4, 4])]) == Estimate(1.5, None, None)
    nothing = Estimate(None, None, None)
    assert estimate_over_seeds([of_seed([None], [0])]) == estimate_over_seeds([]) == nothing


def test_a_rate_without_a_failure_over_trainings_has_the_exact_interval():
    seeds = [of_seed(np.ones(50), np.arange(50))] * 2
    found = estimate_over_seeds(seeds, is_rate=True)
    assert found == estimate_mean(np.ones(100), np.arange(100), is_rate=True)
    assert found.low == pytest.approx(0.9638, abs=1e-4)
