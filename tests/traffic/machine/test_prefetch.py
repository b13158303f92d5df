"""Prefetching: which cache lines, and that it is only a hint."""

import numba
import numpy as np
import pytest

from marl_lanes.traffic.machine import prefetch as module
from marl_lanes.traffic.machine.prefetch import prefetch


@pytest.mark.parametrize(
    ("start", "num_bytes", "offsets"),
    [(0, 64, [0]), (0, 65, [0, 64]), (128, 130, [128, 192, 256]), (8, 0, [])],
)
def test_every_line_of_the_bytes_is_fetched(monkeypatch, start, num_bytes, offsets):
    found = []
    monkeypatch.setattr(module, "_prefetch_line", lambda *line: found.append(line))
    array = np.zeros((2, 100))
    getattr(prefetch, "py_func", prefetch)(array, 1, start, num_bytes)
    assert [(row, offset) for _, row, offset in found] == [(1, offset) for offset in offsets]
    assert all(one is array for one, _, _ in found)


@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="numba's compilation is switched off")
def test_it_is_a_hint_even_of_what_does_not_exist():
    # Without the kernels' cache, so that the compiler's output is there to be read.
    @numba.njit
    def fetch(array, row, num_bytes):
        prefetch(array, row, 0, num_bytes)

    array = np.arange(24.0).reshape(3, 8)
    for row in (0, 2, 3, -1, 10**9):
        fetch(array, row, array.itemsize * 8)
    assert (array == np.arange(24.0).reshape(3, 8)).all()
    (code,) = fetch.inspect_llvm().values()
    assert "call void @llvm.prefetch" in code
