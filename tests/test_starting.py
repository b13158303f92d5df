"""Garbage collection while many modules are loaded."""

import gc
import subprocess
import sys

import pytest

from marl_lanes.starting import uncollected


@pytest.mark.parametrize("is_enabled", [True, False])
def test_collection_pauses_and_is_as_it_was_afterwards(is_enabled):
    was_enabled = gc.isenabled()
    try:
        (gc.enable if is_enabled else gc.disable)()
        with uncollected():
            assert not gc.isenabled()
        assert gc.isenabled() is is_enabled
        with pytest.raises(KeyError), uncollected():
            {}["an import that fails"]
        assert gc.isenabled() is is_enabled
    finally:
        (gc.enable if was_enabled else gc.disable)()


@pytest.mark.slow
def test_the_first_step_loads_no_linear_algebra_and_leaves_it_to_who_compiles_some():
    program = """
import sys
import marl_lanes
marl_lanes.parallel_env("paper").reset(seed=0)
print("scipy.linalg" in sys.modules, "numpy.ma" in sys.modules)
import numba
import numpy as np
product = numba.njit(lambda a, b: np.dot(a, b))(np.eye(3), np.arange(9.0).reshape(3, 3))
print("scipy.linalg" in sys.modules, product[2].tolist())
"""
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout == "False False\nTrue [6.0, 7.0, 8.0]\n"
