"""Without a GPU: every kernel compiles for it, and simulated it does what the CPU does."""

import inspect
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from gpu_compiler import compile_ptx

from marl_lanes import load_scenario
from marl_lanes.traffic.machine.state import allocate
from marl_lanes.traffic.parameters import array_sizes, make_parameters
from marl_lanes.traffic.readout import changer_columns, follower_columns
from marl_lanes.traffic.road.neighbors import neighbor_in_lane

CAPABILITIES = [(8, 0), (9, 0)]
MOST_STACK = 256
"""[bytes] Of a thread: arrays that it indexes with what is known only at run time."""
OTHERS = (
    "fill_rows",
    "seed_roads",
    "look_for_full_roads",
    "copy_numbers",
    "check_actions",
    "check_follower_actions",
    "read_changers",
    "read_followers",
    "read_vehicles",
)

pytestmark = pytest.mark.slow


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


def compile_kernel(name, capability, monkeypatch):
    """Its PTX."""
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
    return compile_ptx(kernel.py_func, [given[one] for one in names], monkeypatch, capability)


def check(ptx, capability):
    assert re.search(rf"^\.target sm_{capability[0]}{capability[1]}$", ptx, re.MULTILINE)
    assert ".entry" in ptx
    stack = sum(int(size) for size in re.findall(r"\.local .*__local_depot\d+\[(\d+)\]", ptx))
    assert stack <= MOST_STACK


@pytest.mark.parametrize("name", OTHERS)
def test_what_surrounds_the_step_compiles(name, monkeypatch):
    check(compile_kernel(name, CAPABILITIES[0], monkeypatch), CAPABILITIES[0])


@pytest.mark.long
@pytest.mark.parametrize("capability", CAPABILITIES)
def test_the_step_compiles(capability, monkeypatch):
    ptx = compile_kernel("advance", capability, monkeypatch)
    check(ptx, capability)
    # The instruction; a function's name may have the word.
    assert not re.search(r"^\s*prefetch", ptx, re.MULTILINE)


@pytest.mark.long
@pytest.mark.parametrize("name", OTHERS)
def test_they_compile_for_the_newer_one(name, monkeypatch):
    check(compile_kernel(name, CAPABILITIES[1], monkeypatch), CAPABILITIES[1])


@pytest.mark.parametrize("stride", [-1, 1])
def test_the_compiler_keeps_the_loop_over_neighbors(stride, monkeypatch):
    """From ``count`` down it once ended after its first round."""
    given = arguments()
    tables = given["vehicles"][0], given["order"][0], given["agents"][0]

    def find(vehicles, order, agents, count, found):
        found[0] = neighbor_in_lane(count, 1, stride, order, count, vehicles, agents)

    ptx = compile_ptx(find, (*tables, 1, np.zeros(1, np.int64)), monkeypatch)
    labels = {}
    for number, line in enumerate(ptx.splitlines()):
        if line.startswith("$L"):
            labels[line.rstrip(":")] = number
        branch = re.search(r"\bbra(?:\.uni)?\s+(\$L\w+);", line)
        if branch and labels.get(branch[1], number) < number:
            return
    pytest.fail("no branch goes back")


def test_every_kernel_is_compiled_here():
    from marl_lanes.traffic import gpu_kernels

    kinds = (type(gpu_kernels.advance),)
    found = {
        name
        for name, one in vars(gpu_kernels).items()
        if isinstance(one, kinds) and not one.targetoptions.get("device")
    }
    assert found == {"advance", *OTHERS}


def test_simulated_it_is_the_cpu():
    program = Path(__file__).parents[1] / "gpu_simulation.py"
    done = subprocess.run(
        [sys.executable, str(program)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == "equal\n"


def test_few_roads_are_spread_over_all_processors():
    from marl_lanes.traffic.gpu import _choose_threads

    assert [_choose_threads(number) for number in (1, 8192, 16384, 10**6)] == [8, 8, 16, 32]
