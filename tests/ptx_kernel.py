"""What CUDA's compiler made of a kernel, on the CPU: no GPU is needed to see what it does.

Its PTX is translated to C (`ptx_in_c.py`). A block's threads are contexts of which one runs at a
time, until it meets others (`ptx_threads.c`).
"""

import ctypes
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from ptx_in_c import Translator

RUNTIME = Path(__file__).with_name("ptx_threads.c")
FLAGS = ("-O1", "-w", "-shared", "-fPIC", "-ffp-contract=off", "-fno-strict-aliasing", "-fwrapv")

needs_c = pytest.mark.skipif(
    sys.platform != "linux" or shutil.which("cc") is None, reason="no C compiler, or not Linux"
)


class CpuKernel:
    """A kernel of a PTX file, compiled for this computer.

    Args:
        ptx: with one entry.
        folder: for the C source and the library.
    """

    def __init__(self, ptx, folder):
        functions, self.kinds = Translator(ptx).translate()
        # A library that is loaded must not be written again.
        folder = Path(tempfile.mkdtemp(dir=folder))
        source = folder / "kernel.c"
        source.write_text(RUNTIME.read_text(encoding="utf-8").replace("// FUNCTIONS", functions))
        library = folder / "kernel.so"
        subprocess.run(["cc", *FLAGS, str(source), "-o", str(library), "-lm"], check=True)
        self._library = ctypes.CDLL(str(library))

    def __call__(self, grid, block, numbers, order=0):
        """Run it; an error if the threads do not find together.

        Args:
            grid: the number of blocks.
            block: threads along the two dimensions of a block.
            numbers: of the parameters, in order.
            order: seed of the order in which threads go on; 0: always the same.
        """
        if len(numbers) != len(self.kinds):
            raise ValueError(f"{len(numbers)} numbers for {len(self.kinds)} parameters")
        cells = (ctypes.c_uint64 * len(numbers))(*(int(number) & (2**64 - 1) for number in numbers))
        places = (ctypes.c_void_p * len(numbers))(
            *(ctypes.addressof(cells) + 8 * number for number in range(len(numbers)))
        )
        run = self._library.run_grid
        run.restype = ctypes.c_char_p
        fault = run(grid, *block, places, ctypes.c_uint64(order))
        if fault is not None:
            raise RuntimeError(fault.decode())


def flatten(arguments):
    """What numba-cuda passes to a kernel for arrays, which are contiguous, and for numbers."""
    for argument in arguments:
        if not hasattr(argument, "strides") or argument.ndim == 0:
            yield argument
            continue
        yield from (0, 0, argument.size, argument.itemsize, argument.ctypes.data)
        yield from argument.shape
        yield from argument.strides
