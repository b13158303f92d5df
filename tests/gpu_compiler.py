"""What numba-cuda compiles, without a GPU: PTX of a function, the machine's code of a kernel."""

import inspect
import re
from typing import NamedTuple

import numpy as np
import pytest
from numba import cuda, typeof
from numba.cuda import dispatcher
from numba.cuda.compiler import compile_all

from marl_lanes import load_scenario
from marl_lanes.traffic.machine.graphics import find_linker_fault
from marl_lanes.traffic.machine.state import allocate
from marl_lanes.traffic.parameters import array_sizes, make_parameters
from marl_lanes.traffic.readout import changer_columns, follower_columns

CAPABILITIES = [(8, 0), (9, 0)]


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

    fault = find_linker_fault()
    if fault is not None:
        pytest.skip(fault)
    pretend_device(monkeypatch, capability)
    types = tuple(map(typeof, arguments))
    bounds = kernel.targetoptions.get("launch_bounds")
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


def arguments():
    """An argument of each kernel by its name."""
    scenario = load_scenario("hidden")
    state = allocate(num_envs=2, **array_sizes(scenario))
    flat = state.agents.shape
    flag = np.empty((2, 1), np.bool_)
    numbers = np.zeros((*flat, 1))
    return {
        **vars(state),
        **vars(make_parameters(scenario)),
        **changer_columns(flat),
        **follower_columns(flat),
        **dict.fromkeys(("road_done", "road_terminated", "road_truncated"), flag),
        **dict.fromkeys(("mode", "num_steps", "policy"), 0),
        **dict.fromkeys(("seed", "first_road"), np.uint64(0)),
        **dict.fromkeys(("actions", "follower_actions", "kept"), numbers),
        "given": numbers.astype(np.float32),
        "has_longitudinal": True,
        **dict.fromkeys(("refused", "alarms"), np.zeros(2, np.int64)),
    }


def kernel_arguments(name):
    """A kernel, and its arguments in order."""
    from marl_lanes.traffic import gpu_kernels

    kernel = getattr(gpu_kernels, name)
    given = arguments()
    if name in {"advance", "look_for_full_roads", "fill_rows"}:
        given["mask"] = np.ones(2, np.bool_)
    if name == "fill_rows":
        given |= {"rows": np.zeros((2, 3), np.uint32), "row": np.zeros(3, np.uint32)}
    if name == "read_vehicles":
        given["rows"] = np.zeros((2, 3, 7), np.float32)
    names = inspect.signature(kernel.py_func).parameters
    return kernel, [given[one] for one in names]
