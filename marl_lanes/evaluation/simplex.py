"""Minimum of a sum of convex functions of linear quantities, each with at most three kinks.

f(a) = sum over the quantities q of w_q |x_q| + P max(0, |x_q| - b_q), x = free + R a; the a_k are
also quantities. At a minimum as many quantities are at a kink (at -b, 0 or b) as there are
unknowns. Each exchange starts from such a vertex, the first one from a = 0. One quantity leaves its
kink along the edge of steepest descent, and passes the kinks of others as long as f falls. The
quantity at whose kink it stops takes its place. This is the dual simplex method with long steps,
applied to the dual of the linear program without building the program. From a = 0 it needs few
exchanges, because most actions of an optimum are 0.

The tableau is x = x_0 + T t for the quantities off their kinks; t is the distance of the other
quantities from their kinks. Many quantities start exactly at a kink, where the descent could stop.
Tiny shifts of the kinks prevent this; the exact solution is updated without the shifts.
"""

from typing import Any

import numpy as np
import numpy.typing as npt

from marl_lanes.traffic.machine.compiled import compiled

FloatArray = npt.NDArray[np.float64]

PENALTY = 1e4
"""P, per unit beyond a bound; larger than any gain from leaving a bound that can be kept."""

_SHIFT = 1e-9
_MIN_PIVOT = 1e-9
_MIN_DESCENT = 1e-9


@compiled
def _next_kink(x: float, way: float, weight: float, bound: float) -> float:
    """The first kink strictly ahead of x in the direction ``way``, or infinity (with its sign)."""
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
    """Derivative of w |x| + P max(0, |x| - b); at a kink the one on the given side."""
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
def _edge(
    tableau: Any,
    shifted: Any,
    rows: Any,
    columns: Any,
    kinks: Any,
    weights: Any,
    bounds: Any,
    gradient: Any,
    norms: Any,
) -> tuple[int, float, float]:
    """The column of steepest descent (-1 for none), its direction, and the derivative of f."""
    m, n = tableau.shape
    for j in range(n):
        gradient[j] = 0.0
        norms[j] = weights[columns[j]] * weights[columns[j]] + 1e-12
    for i in range(m):
        weight = weights[rows[i]]
        slope, scale = _slope(shifted[i], 1.0, weight, bounds[rows[i]]), weight * weight
        for j in range(n):
            gradient[j] += slope * tableau[i, j]
            norms[j] += scale * tableau[i, j] * tableau[i, j]
    best, way, rate, steepness = -1, 1.0, 0.0, 0.0
    for j in range(n):
        q = columns[j]
        right = gradient[j] + _slope(kinks[j], 1.0, weights[q], bounds[q])
        left = -gradient[j] - _slope(kinks[j], -1.0, weights[q], bounds[q])
        steepest = min(right, left)
        if steepest < -_MIN_DESCENT and steepest * steepest > steepness * norms[j]:
            best, rate, steepness = j, steepest, steepest * steepest / norms[j]
            way = 1.0 if right < left else -1.0
    return best, way, rate


@compiled
def _stop(
    tableau: Any,
    shifted: Any,
    rows: Any,
    columns: Any,
    kinks: Any,
    weights: Any,
    bounds: Any,
    ahead: Any,
    best: int,
    way: float,
    rate: float,
) -> tuple[int, float]:
    """The kink after which f no longer falls along the edge.

    Returns:
        Its row (-1 for the column's own quantity, -2 if f falls without end), and the kink.
    """
    for i in range(tableau.shape[0]):
        speed = way * tableau[i, best]
        ahead[i] = np.inf
        if abs(speed) > _MIN_PIVOT:
            kink = _next_kink(shifted[i], speed, weights[rows[i]], bounds[rows[i]])
            ahead[i] = (kink - shifted[i]) / speed
    q = columns[best]
    own = kinks[best]
    while True:
        leaving, distance = -2, np.inf
        for i in range(tableau.shape[0]):
            if ahead[i] < distance:
                leaving, distance = i, ahead[i]
        next_own = _next_kink(own, way, weights[q], bounds[q])
        if abs(next_own - kinks[best]) < distance:
            own = next_own
            rate += PENALTY if abs(own) == bounds[q] else 2.0 * weights[q]
            if rate >= 0.0:
                return -1, own
            continue
        if leaving < 0:
            return leaving, 0.0
        speed, r = way * tableau[leaving, best], rows[leaving]
        # Select the nearest of its kinks, so that rounding does not matter.
        reached = shifted[leaving] + speed * distance
        kink = 0.0
        if abs(abs(reached) - bounds[r]) < abs(reached):
            kink = bounds[r] if reached > 0.0 else -bounds[r]
        rate += abs(speed) * (PENALTY if kink != 0.0 else 2.0 * weights[r])
        if rate >= 0.0:
            return leaving, kink
        further = _next_kink(kink, speed, weights[r], bounds[r])
        ahead[leaving] = (further - shifted[leaving]) / speed


@compiled
def _exchange(tableau: Any, pivots: Any, leaving: int, best: int) -> None:
    """Exchange the row ``leaving`` and the column ``best``; ``pivots`` (n,) is working memory."""
    inverse = 1.0 / tableau[leaving, best]
    for j in range(tableau.shape[1]):
        pivots[j] = tableau[leaving, j] * inverse
    for i in range(tableau.shape[0]):
        factor = tableau[i, best]
        if i == leaving or factor == 0.0:
            continue
        for j in range(tableau.shape[1]):
            tableau[i, j] -= factor * pivots[j]
        tableau[i, best] = factor * inverse
    for j in range(tableau.shape[1]):
        tableau[leaving, j] = -pivots[j]
    tableau[leaving, best] = inverse


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
    gradient: Any,
    norms: Any,
    ahead: Any,
    max_exchanges: int,
) -> int:
    """Exchange until f falls along no edge.

    Args:
        tableau: (m, n) T, overwritten.
        shifted: (m,) values of the quantities off their kinks, with the kinks shifted.
        exact: (m,) the same without the shifts.
        rows: (m,) int64, quantity of each row.
        columns: (n,) int64, quantity of each column.
        kinks: (n,) present kink of each column.
        weights: (m + n,) w by quantity.
        bounds: (m + n,) b by quantity, infinite for none.
        gradient: (n,) working memory.
        norms: (n,) working memory.
        ahead: (m,) working memory.
        max_exchanges: > 0.

    Returns:
        The number of exchanges; max_exchanges if they were not enough.
    """
    for count in range(max_exchanges):
        best, way, rate = _edge(
            tableau, shifted, rows, columns, kinks, weights, bounds, gradient, norms
        )
        if best < 0:
            return count
        leaving, kink = _stop(
            tableau, shifted, rows, columns, kinks, weights, bounds, ahead, best, way, rate
        )
        if leaving < -1:
            break
        step = exact_step = kink - kinks[best]
        if leaving >= 0:
            step = (kink - shifted[leaving]) / tableau[leaving, best]
            exact_step = (kink - exact[leaving]) / tableau[leaving, best]
        for i in range(tableau.shape[0]):
            shifted[i] += tableau[i, best] * step
            exact[i] += tableau[i, best] * exact_step
        if leaving >= 0:
            shifted[leaving] = kinks[best] + step
            exact[leaving] = kinks[best] + exact_step
            rows[leaving], columns[best] = columns[best], rows[leaving]
            _exchange(tableau, gradient, leaving, best)
        kinks[best] = kink
    return max_exchanges


def minimise(
    free: FloatArray,
    response: FloatArray,
    weights: FloatArray,
    bounds: FloatArray,
) -> FloatArray:
    """The a with the smallest f.

    Args:
        free: (m,) values at a = 0 of the quantities that are not actions.
        response: (m, n) their derivatives by the actions.
        weights: (n + m,) w of the actions, then of the other quantities, >= 0.
        bounds: (n + m,) b in the same order, > 0, infinite for none.

    Returns:
        (n,) float64.

    Raises:
        RuntimeError: the limit of exchanges is reached.
    """
    m, n = response.shape
    # Irrational steps, so that no two sums of shifts are equal.
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
