"""Minimum of a sum of convex functions of linear quantities, each with at most three kinks.

f(a) = sum over the quantities q of w_q |x_q| + P max(0, |x_q| - b_q), x = free + R a, the a_k among
the quantities. A minimum lies where as many quantities are at a kink (at -b, 0 or b) as there are
unknowns. From such a vertex, at first a = 0, one quantity leaves its kink along the edge of
steepest descent, over the kinks of others for as long as f falls; the one at whose kink it stops
takes its place. It is the dual simplex method with long steps on the dual of the linear program,
without the program: from a = 0 few exchanges are needed, as most actions of an optimum are 0.

The tableau is x = x_0 + T t for the quantities off their kinks, t the distance of those at a kink
from it. Many quantities begin exactly at a kink; tiny shifts of the kinks keep the descent from
standing still, and the solution is carried along without them.
"""

from typing import Any

import numpy as np
import numpy.typing as npt

from marl_lanes.traffic.compiled import compiled

FloatArray = npt.NDArray[np.float64]

PENALTY = 1e4
"""P, for each unit beyond a bound; more than a bound is ever worth where it can be kept."""

_SHIFT = 1e-9
_MIN_PIVOT = 1e-9
_MIN_DESCENT = 1e-9


@compiled
def _next_kink(x: float, way: float, weight: float, bound: float) -> float:
    """The first kink strictly ahead of x in the direction ``way``, or infinity in it."""
    if way > 0.0:
        if x < -bound:
            return -bound
        if x < 0.0 and weight > 0.0:
            return 0.0
        return bound if x < bound else np.inf
    if x > bound:
        return bound
    if x > 0.0 and weight > 0.0:
        return 0.0
    return -bound if x > -bound else -np.inf


@compiled
def _slope(x: float, side: float, weight: float, bound: float) -> float:
    """Derivative of w |x| + P max(0, |x| - b), of a kink that on the given side."""
    slope = 0.0
    if x > 0.0 or (x == 0.0 and side > 0.0):
        slope += weight
    else:
        slope -= weight
    if x > bound or (x == bound and side > 0.0):
        slope += PENALTY
    if x < -bound or (x == -bound and side < 0.0):
        slope -= PENALTY
    return slope


@compiled
def descend(
    tableau: Any,
    shifted: Any,
    exact: Any,
    rows: Any,
    columns: Any,
    kinks: Any,
    weights: Any,
    bounds: Any,
    slopes: Any,
    gradient: Any,
    norms: Any,
    ahead: Any,
    max_exchanges: int,
) -> int:
    """Exchange until no edge descends.

    Args:
        tableau: (m, n) T, overwritten.
        shifted: (m,) values of the quantities off their kinks, with the kinks shifted.
        exact: (m,) the same without the shifts.
        rows: (m,) int64, which quantity each row is.
        columns: (n,) int64, which quantity each column is.
        kinks: (n,) at which of its kinks a column is.
        weights: (m + n,) w by quantity.
        bounds: (m + n,) b by quantity, infinite for none.
        slopes, ahead: (m,) work.
        gradient, norms: (n,) work.
        max_exchanges: > 0.

    Returns:
        The number of exchanges; max_exchanges where they were not enough.
    """
    m, n = tableau.shape
    for count in range(max_exchanges):
        for j in range(n):
            gradient[j] = 0.0
            norms[j] = weights[columns[j]] * weights[columns[j]] + 1e-12
        for i in range(m):
            weight = weights[rows[i]]
            slope = _slope(shifted[i], 1.0, weight, bounds[rows[i]])
            slopes[i] = slope
            scale = weight * weight
            for j in range(n):
                gradient[j] += slope * tableau[i, j]
                norms[j] += scale * tableau[i, j] * tableau[i, j]
        best, descent, way = -1, 0.0, 1.0
        for j in range(n):
            q = columns[j]
            right = gradient[j] + _slope(kinks[j], 1.0, weights[q], bounds[q])
            left = -gradient[j] - _slope(kinks[j], -1.0, weights[q], bounds[q])
            steepest = min(right, left)
            if steepest < -_MIN_DESCENT and steepest * steepest > descent * norms[j]:
                best, descent = j, steepest * steepest / norms[j]
                way = 1.0 if right < left else -1.0
        if best < 0:
            return count
        q = columns[best]
        rate = way * gradient[best] + way * _slope(kinks[best], way, weights[q], bounds[q])
        # Distances to the next kinks, then over them in turn while f falls.
        for i in range(m):
            speed = way * tableau[i, best]
            ahead[i] = np.inf
            if abs(speed) > _MIN_PIVOT:
                kink = _next_kink(shifted[i], speed, weights[rows[i]], bounds[rows[i]])
                ahead[i] = (kink - shifted[i]) / speed
        own = kinks[best]
        while True:
            leaving, distance = -1, np.inf
            for i in range(m):
                if ahead[i] < distance:
                    leaving, distance = i, ahead[i]
            next_own = _next_kink(own, way, weights[q], bounds[q])
            is_own = abs(next_own - kinks[best]) < distance
            if is_own:
                distance = abs(next_own - kinks[best])
                own = next_own
                rate += PENALTY if abs(own) == bounds[q] else 2.0 * weights[q]
                if rate >= 0.0:
                    break
                continue
            if leaving < 0:
                return max_exchanges
            speed = way * tableau[leaving, best]
            kink = shifted[leaving] + speed * distance
            r = rows[leaving]
            # Which of its kinks: rounding must not miss it.
            place = 0.0
            if bounds[r] < np.inf and abs(abs(kink) - bounds[r]) < abs(kink):
                place = bounds[r] if kink > 0.0 else -bounds[r]
            jump = PENALTY if place != 0.0 else 2.0 * weights[r]
            rate += abs(speed) * jump
            if rate >= 0.0:
                break
            further = _next_kink(place, speed, weights[r], bounds[r])
            ahead[leaving] = (further - shifted[leaving]) / speed
        if is_own:
            step = own - kinks[best]
            kinks[best] = own
            for i in range(m):
                shifted[i] += tableau[i, best] * step
                exact[i] += tableau[i, best] * step
            continue
        pivot = tableau[leaving, best]
        step = (place - shifted[leaving]) / pivot
        exact_step = (place - exact[leaving]) / pivot
        for i in range(m):
            shifted[i] += tableau[i, best] * step
            exact[i] += tableau[i, best] * exact_step
        shifted[leaving] = kinks[best] + step
        exact[leaving] = kinks[best] + exact_step
        kinks[best] = place
        rows[leaving], columns[best] = columns[best], rows[leaving]
        inverse = 1.0 / pivot
        for j in range(n):
            gradient[j] = tableau[leaving, j] * inverse
        for i in range(m):
            factor = tableau[i, best]
            if i == leaving or factor == 0.0:
                continue
            for j in range(n):
                tableau[i, j] -= factor * gradient[j]
            tableau[i, best] = factor * inverse
        for j in range(n):
            tableau[leaving, j] = -gradient[j]
        tableau[leaving, best] = inverse
    return max_exchanges


def minimise(
    free: FloatArray,
    response: FloatArray,
    weights: FloatArray,
    bounds: FloatArray,
) -> FloatArray:
    """The a of least f.

    Args:
        free: (m,) of the quantities that are not actions, at a = 0.
        response: (m, n) of them by the actions.
        weights: (n + m,) w of the actions, then of the others, >= 0.
        bounds: (n + m,) b in that order, > 0, infinite for none.

    Returns:
        (n,) float64.

    Raises:
        RuntimeError: too many exchanges.
    """
    m, n = response.shape
    # Irrational steps: no two sums of shifts are equal.
    shifts = _SHIFT * (0.5 + np.modf(np.arange(1, m + n + 1) * 0.6180339887498949)[0])
    shifted = free + shifts[n:] - response @ shifts[:n]
    exact = free.copy()
    rows, columns = np.arange(n, m + n), np.arange(n)
    kinks = np.zeros(n)
    limit = 50 * (m + n)
    count = descend(
        response.copy(),
        shifted,
        exact,
        rows,
        columns,
        kinks,
        weights,
        bounds,
        np.empty(m),
        np.empty(n),
        np.empty(n),
        np.empty(m),
        limit,
    )
    if count == limit:
        raise RuntimeError(f"no minimum after {limit} exchanges")
    values = np.empty(m + n)
    values[rows], values[columns] = exact, kinks
    return values[:n]
