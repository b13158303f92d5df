"""Kernels of a GPU that are kept on disk, and launches that are prepared."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from devices import needs_gpu

from marl_lanes.traffic.machine.graphics import find_linker_fault

TESTS = Path(__file__).parents[2]
KEPT = """
from marl_lanes.traffic.machine.compiled import internal
from marl_lanes.traffic.machine.launches import gpu_kernel

@internal
def twice(x):
    return x * 2.0

@gpu_kernel()
def double(array):
    array[0] = twice(array[0])
"""

PROGRAM = "import pretended_gpu; pretended_gpu.main({capability!r}, 'kept:double', {kind!r})"
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


@pytest.fixture
def compile_it(tmp_path, monkeypatch):
    """A function that compiles the kernel in a process of its own."""
    if find_linker_fault() is not None:
        pytest.skip(find_linker_fault())
    (tmp_path / "kept.py").write_text(KEPT)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), str(TESTS)]))
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")

    def run(capability="9.0", *, kind="float64", before=""):
        """Whether the kernel was kept, the digest of its code, and what was logged."""
        program = f"{before}\n{PROGRAM.format(capability=capability, kind=kind)}"
        done = subprocess.run(
            [sys.executable, "-c", program], capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        hits, code = done.stdout.split()
        return hits == "1", code, done.stderr.strip()

    return run


@pytest.mark.slow
def test_a_kernel_is_compiled_once_for_a_kind_of_gpu(compile_it):
    is_kept, code, logged = compile_it()
    assert (is_kept, logged) == (False, "")
    assert compile_it() == (True, code, "")
    is_kept, other, _ = compile_it("8.0")
    assert not is_kept
    assert other != code
    assert compile_it("8.0") == (True, other, "")
    assert compile_it() == (True, code, "")


@pytest.mark.slow
def test_a_kernel_of_other_sources_is_compiled_anew(compile_it):
    internals = "marl_lanes.traffic.machine.numba_internals"
    compile_it(before=f"import {internals} as n; n.SOURCES = 'of before'")
    is_kept, code, logged = compile_it()
    assert (is_kept, logged) == (False, "")
    assert compile_it() == (True, code, "")


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["nbi", "nbc"])
def test_a_damaged_file_is_replaced(compile_it, tmp_path, suffix):
    _, code, _ = compile_it()
    (path,) = (tmp_path / "cache").rglob(f"*.{suffix}")
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    assert compile_it() == (False, code, "")
    assert compile_it() == (True, code, "")


@pytest.mark.slow
def test_a_kernel_of_other_types_is_replaced(compile_it, tmp_path):
    """Two processes that write at once may leave the index of one with the code of the other."""
    _, code, _ = compile_it()
    _, other, _ = compile_it(kind="float32")
    one, two = sorted((tmp_path / "cache").rglob("*.nbc"))
    content = one.read_bytes()
    one.write_bytes(two.read_bytes())
    two.write_bytes(content)
    assert compile_it() == (False, code, "")
    assert compile_it() == (True, code, "")
    assert compile_it(kind="float32")[1] == other != code


@pytest.mark.slow
def test_in_a_version_with_other_names_nothing_is_kept(compile_it):
    gone = "import marl_lanes.traffic.machine.launches as n; n.CAN_KEEP = False"
    message = "compiled kernels are not kept on disk: this version of numba-cuda is not known"
    for _ in range(2):
        is_kept, _, logged = compile_it(before=gone)
        assert (is_kept, logged) == (False, message)


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
