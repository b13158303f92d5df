"""Launches that are prepared: the same kernel with the same arguments, again and again."""

import subprocess
import sys

import numpy as np
import pytest
from devices import needs_gpu

SIMULATED = """
import numpy as np
from marl_lanes.traffic.machine.launches import Launch
from numba import cuda

@cuda.jit
def add(array, number):
    index = cuda.grid(1)
    if index < array.shape[0]:
        array[index] += number

array = cuda.to_device(np.arange(5))
launch = Launch(add, 5, (array, np.int64(2)), (4,))
for _ in range(3):
    launch(0)
assert array.copy_to_host().tolist() == [6, 7, 8, 9, 10]
"""


@pytest.mark.slow
def test_every_call_is_a_launch(monkeypatch):
    monkeypatch.setenv("NUMBA_ENABLE_CUDASIM", "1")
    done = subprocess.run(
        [sys.executable, "-c", SIMULATED], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


@needs_gpu
def test_prepared_it_does_the_same():
    from numba import cuda

    from marl_lanes.traffic.machine.launches import Launch, _prepare

    @cuda.jit
    def add(array, number):
        index = cuda.grid(1)
        if index < array.shape[0]:
            array[index] += number

    array = cuda.to_device(np.zeros(300, np.int64))
    given = array, np.int64(2)
    launch = Launch(add, 300, given, (128,))
    for _ in range(4):
        launch(0)
    assert set(array.copy_to_host().tolist()) == {8}
    assert _prepare(add, given, 3, (128,), 0) is not None
