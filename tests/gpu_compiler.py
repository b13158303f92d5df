"""What numba-cuda compiles, without a GPU: PTX of a function, the machine's code of a kernel."""

import re
from typing import NamedTuple

from numba import cuda, typeof
from numba.cuda import dispatcher
from numba.cuda.compiler import compile_all


def pretend_device(monkeypatch, capability):
    """The compiler asks the present GPU what it can do."""

    class Device:
        compute_capability = capability
        id = 0

    monkeypatch.setattr(dispatcher, "get_current_device", Device)


def compile_ptx(function, arguments, monkeypatch, capability=(8, 0)):
    """The PTX of a function as a kernel for arguments like these."""
    pretend_device(monkeypatch, capability)
    ptx, _ = cuda.compile_ptx(function, tuple(map(typeof, arguments)), cc=capability)
    return ptx


class Built(NamedTuple):
    """A kernel as a GPU runs it."""

    ptx: str
    """After all functions were linked."""
    num_registers: int
    """Of a thread."""
    stack: int
    """[bytes] Of a thread."""


def build(kernel, arguments, monkeypatch, capability):
    """Compile and link a kernel as its first launch does."""
    from cuda.bindings import nvjitlink

    pretend_device(monkeypatch, capability)
    types = tuple(map(typeof, arguments))
    bounds = kernel.targetoptions["launch_bounds"]
    (code,), _ = compile_all(
        kernel.py_func,
        types,
        cc=capability,
        device=False,
        abi="numba",
        output="ltoir",
        launch_bounds=bounds,
    )

    def link(*options):
        options = [f"-arch=sm_{capability[0]}{capability[1]}", "-lto", *options]
        linker = nvjitlink.create(len(options), options)
        nvjitlink.add_data(linker, nvjitlink.InputType.LTOIR, code, len(code), "kernel")
        nvjitlink.complete(linker)
        return linker

    linker = link("-ptx")
    ptx = bytearray(nvjitlink.get_linked_ptx_size(linker))
    nvjitlink.get_linked_ptx(linker, ptx)
    nvjitlink.destroy(linker)
    linker = link("-verbose")
    log = bytearray(nvjitlink.get_info_log_size(linker))
    nvjitlink.get_info_log(linker, log)
    nvjitlink.destroy(linker)
    report = log.decode(errors="replace")
    (registers,) = re.findall(r"Used (\d+) registers", report)
    stack = re.search(r"(\d+) bytes cumulative stack size", report)
    return Built(ptx.decode(), int(registers), int(stack[1]) if stack else 0)
