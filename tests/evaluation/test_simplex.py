"""The simplex method, compared with scipy's solver."""

import numpy as np
import pytest
from scipy.optimize import linprog

from marl_lanes.evaluation.simplex import minimise


def test_the_simplex_method_finds_what_linprog_finds():
    """Random sums of |x| with bounds, feasible by construction or infeasible."""
    rng = np.random.default_rng(3)
    num_infeasible = 0
    for _ in range(60):
        n, m = int(rng.integers(1, 12)), int(rng.integers(1, 20))
        response = rng.standard_normal((m, n))
        free = rng.standard_normal(m) * rng.integers(0, 2, m)
        weights = rng.uniform(0.0, 2.0, n + m) * rng.integers(0, 2, n + m)
        bounds = np.where(rng.random(n + m) < 0.4, rng.uniform(0.1, 1.5, n + m), np.inf)
        found = minimise(free, response, weights, bounds)
        values = np.abs(np.concatenate([found, free + response @ found]))
        # |x| <= u: the unknowns are a, then u.
        rows = np.vstack([np.eye(n), response])
        both = np.block([[rows, -np.eye(n + m)], [-rows, -np.eye(n + m)]])
        offset = np.concatenate([np.zeros(n), free])
        limits = [(None, None)] * n + [(0.0, bound) for bound in bounds]
        given = np.concatenate([np.zeros(n), weights])
        expected = linprog(given, A_ub=both, b_ub=np.concatenate([-offset, offset]), bounds=limits)
        if expected.status == 2:
            num_infeasible += 1
            assert (values > bounds + 1e-6).any()
        else:
            assert (values <= bounds + 1e-7).all()
            assert weights @ values == pytest.approx(expected.fun, rel=1e-7, abs=1e-7)
    assert 5 < num_infeasible < 55
