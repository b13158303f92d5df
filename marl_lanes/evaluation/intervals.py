"""Confidence intervals of means and rates over maneuvers that share roads."""

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
    _, group = np.unique(labels, return_inverse=True)
    sums, counts = np.bincount(group, sample), np.bincount(group).astype(np.float64)
    if sums.size < 2:
        return Estimate(value, None, None)
    interval = stats.bootstrap(
        (sums, counts),
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


def _ratio_of_sums(sums: NDArray[Any], counts: NDArray[Any], axis: int = -1) -> NDArray[Any]:
    return np.asarray(sums.sum(axis=axis) / counts.sum(axis=axis))
