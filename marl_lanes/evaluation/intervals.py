"""Confidence intervals of means and rates over maneuvers that share roads."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

CONFIDENCE = 0.95
"""Default nominal coverage of the intervals."""
NUM_RESAMPLES = 9999
"""Bootstrap resamples per interval."""
_BATCH = 500
"""Resamples held in memory at once."""


@dataclass(frozen=True)
class Estimate:
    """A mean and its confidence interval; None if the sample does not define them."""

    value: float | None
    low: float | None
    high: float | None


def estimate_mean(
    values: ArrayLike,
    groups: ArrayLike,
    *,
    is_rate: bool,
    confidence: float = CONFIDENCE,
    seed: int = 0,
) -> Estimate:
    """Mean of the defined values, with a cluster bootstrap interval (percentile method).

    Maneuvers on one road share its traffic and are not independent, so whole groups are drawn with
    replacement. The mean of a resample is the sum of its values divided by their number. Groups
    without a defined value are left out. A single group has no interval.

    If a rate is 0 or 1, every resample is the same and the bootstrap gives no width. The interval
    is then the exact one (Clopper-Pearson), with the values treated as independent.

    Args:
        values: (N,) one per maneuver; nan or inf if it is not defined. For a rate: 0 or 1.
        groups: (N,) the road of each maneuver.
        is_rate: whether the values are 0 or 1.
        confidence: coverage, between 0 and 1.
        seed: of the resamples; equal seeds draw the same groups.

    Raises:
        ValueError: the shapes differ, ``confidence`` is out of range, or a value of a rate is
            neither 0 nor 1.
    """
    sample = np.asarray(values, np.float64)
    labels = np.asarray(groups)
    if sample.ndim != 1 or sample.shape != labels.shape:
        raise ValueError(
            f"values: shape {sample.shape}, groups: shape {labels.shape}; both must be (N,)"
        )
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"confidence = {confidence}: must be between 0 and 1")
    is_defined = np.isfinite(sample)
    sample, labels = sample[is_defined], labels[is_defined]
    if is_rate and not np.isin(sample, (0.0, 1.0)).all():
        raise ValueError("values: the values of a rate must be 0 or 1")
    if not sample.size:
        return Estimate(None, None, None)
    value = float(sample.mean())
    if is_rate and value in {0.0, 1.0}:
        exact = stats.binomtest(int(sample.sum()), sample.size).proportion_ci(confidence)
        return Estimate(value, float(exact.low), float(exact.high))
    counts = np.ones(sample.size)
    return _estimate(value, sample, counts, labels, confidence=confidence, seed=seed)


def estimate_ratio(
    numerators: ArrayLike,
    denominators: ArrayLike,
    groups: ArrayLike,
    *,
    confidence: float = CONFIDENCE,
    seed: int = 0,
) -> Estimate:
    """Sum of the numerators divided by the sum of the denominators, with an interval.

    The interval is that of ``estimate_mean``: whole groups are drawn. Maneuvers of which one of the
    two is not defined are left out.

    Args:
        numerators: (N,) one per maneuver.
        denominators: (N,) all of one sign.
        groups: (N,) the road of each maneuver.
        confidence: coverage, between 0 and 1.
        seed: of the resamples.
    """
    upper, lower = np.asarray(numerators, np.float64), np.asarray(denominators, np.float64)
    is_defined = np.isfinite(upper) & np.isfinite(lower)
    upper, lower, labels = upper[is_defined], lower[is_defined], np.asarray(groups)[is_defined]
    if not upper.size or not lower.sum():
        return Estimate(None, None, None)
    value = float(upper.sum() / lower.sum())
    return _estimate(value, upper, lower, labels, confidence=confidence, seed=seed)


def estimate_over_seeds(
    seeds: Sequence[tuple[ArrayLike, ArrayLike, ArrayLike]],
    *,
    is_rate: bool = False,
    confidence: float = CONFIDENCE,
    seed: int = 0,
) -> Estimate:
    """Sum of all numerators divided by that of all denominators, over several trainings.

    A resample draws as many trainings as there are, with replacement, and of each drawn one whole
    groups: maneuvers of one training share its policy, those of one road its traffic. Of one
    training only the groups are drawn; a single group has no interval. A rate of 0 or 1 has the
    exact interval, as in ``estimate_mean``. Values that are not finite are left out.

    Args:
        seeds: of each training the numerators (N,), the denominators (N,), ones for a mean, and
            the groups (N,), the road of each maneuver.
        is_rate: whether the numerators are 0 or 1, and the denominators 1.
        confidence: coverage, between 0 and 1.
        seed: of the resamples.
    """
    parts = []
    for numerators, denominators, groups in seeds:
        upper, lower = np.asarray(numerators, np.float64), np.asarray(denominators, np.float64)
        is_defined = np.isfinite(upper) & np.isfinite(lower)
        _, group = np.unique(np.asarray(groups)[is_defined], return_inverse=True)
        if group.size:
            sums = [np.bincount(group, values[is_defined]) for values in (upper, lower)]
            parts.append(np.stack(sums))
    total = np.sum([part.sum(axis=1) for part in parts], axis=0) if parts else np.zeros(2)
    if not total[1]:
        return Estimate(None, None, None)
    value = float(total[0] / total[1])
    if is_rate and value in {0.0, 1.0}:
        exact = stats.binomtest(round(total[0]), round(total[1])).proportion_ci(confidence)
        return Estimate(value, float(exact.low), float(exact.high))
    if sum(part.shape[1] for part in parts) < 2:
        return Estimate(value, None, None)
    generator = np.random.default_rng(seed)
    drawn = np.zeros((2, NUM_RESAMPLES))
    for chosen in generator.integers(len(parts), size=(len(parts), NUM_RESAMPLES)):
        for index, part in enumerate(parts):
            (resamples,) = np.nonzero(chosen == index)
            for some in np.array_split(resamples, len(resamples) // _BATCH + 1):
                drawn_groups = generator.integers(part.shape[1], size=(len(some), part.shape[1]))
                drawn[:, some] += part[:, drawn_groups].sum(axis=-1)
    tail = (1.0 - confidence) / 2.0
    low, high = np.quantile(drawn[0] / drawn[1], (tail, 1.0 - tail))
    return Estimate(value, float(low), float(high))


def _estimate(
    value: float,
    upper: NDArray[np.float64],
    lower: NDArray[np.float64],
    labels: NDArray[Any],
    *,
    confidence: float,
    seed: int,
) -> Estimate:
    """The value with the bootstrap interval of sum(upper)/sum(lower) over whole groups."""
    _, group = np.unique(labels, return_inverse=True)
    sums = np.bincount(group, upper), np.bincount(group, lower)
    if sums[0].size < 2:
        return Estimate(value, None, None)
    interval = stats.bootstrap(
        sums,
        _ratio_of_sums,
        paired=True,
        vectorized=True,
        method="percentile",
        confidence_level=confidence,
        n_resamples=NUM_RESAMPLES,
        batch=_BATCH,
        random_state=np.random.default_rng(seed),
    ).confidence_interval
    return Estimate(value, float(interval.low), float(interval.high))


def _ratio_of_sums(upper: NDArray[Any], lower: NDArray[Any], axis: int = -1) -> NDArray[Any]:
    return np.asarray(upper.sum(axis=axis) / lower.sum(axis=axis))
