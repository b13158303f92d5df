"""Where threads of a GPU meet: nothing on the CPU, an instruction on a GPU."""

import numpy as np
import pytest
from gpu_compiler import compile_ptx

from marl_lanes.traffic.machine.compiled import compiled
from marl_lanes.traffic.machine.convergence import converge


def count(numbers, counts):
    rank = 0
    while rank < numbers.shape[0]:
        converge()
        while rank < numbers.shape[0] and numbers[rank] > 0:
            counts[0] += 1
            rank += 1
        if rank < numbers.shape[0]:
            counts[1] += 1
            rank += 1


ARGUMENTS = np.array([1, 0, 0, 1, 1, 0]), np.zeros(2, np.int64)


@pytest.mark.slow
def test_it_does_nothing_on_the_cpu():
    numbers, counts = ARGUMENTS[0], np.zeros(2, np.int64)
    compiled(count)(numbers, counts)
    assert counts.tolist() == [3, 3]


@pytest.mark.slow
def test_it_is_an_instruction_on_a_gpu(monkeypatch):
    ptx = compile_ptx(count, ARGUMENTS, monkeypatch)
    assert ptx.count("bar.warp.sync") >= 1
