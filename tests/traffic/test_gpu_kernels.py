"""Without a GPU: every kernel compiles for it, and simulated it does what the CPU does."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from gpu_compiler import CAPABILITIES, arguments, build, compile_ptx, kernel_arguments

from marl_lanes.traffic import step
from marl_lanes.traffic.machine.team import MOST_MEMBERS
from marl_lanes.traffic.road.neighbors import neighbor_in_lane

MOST_STACK = 256
"""[bytes] Of a thread: what its registers do not hold."""
REGISTERS = 65_536
"""Of each processor of a GPU with either capability."""
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


def check(name, capability, monkeypatch):
    kernel, given = kernel_arguments(name)
    ptx = compile_ptx(kernel.py_func, given, monkeypatch, capability)
    assert re.search(rf"^\.target sm_{capability[0]}{capability[1]}$", ptx, re.MULTILINE)
    assert ".entry" in ptx
    stack = sum(int(size) for size in re.findall(r"\.local .*__local_depot\d+\[(\d+)\]", ptx))
    assert stack <= MOST_STACK


@pytest.mark.parametrize("capability", CAPABILITIES)
@pytest.mark.parametrize("name", OTHERS)
def test_what_surrounds_the_step_compiles(name, capability, monkeypatch):
    check(name, capability, monkeypatch)


def count_meetings():
    """Where the members of a team meet or vote, in the sources of the step."""
    calls = r"(?<!def )\b(meet|any_member)\("
    sources = Path(step.__file__).parent.rglob("*.py")
    texts = [path.read_text(encoding="utf-8") for path in sources if path.name != "team.py"]
    return sum(len(re.findall(calls, text)) for text in texts)


@pytest.mark.parametrize("capability", CAPABILITIES)
def test_the_step_compiles(capability, monkeypatch):
    from marl_lanes.traffic.gpu_kernels import GROUPS_AT_WORK

    built = build(*kernel_arguments("advance"), monkeypatch, capability)
    assert built.num_registers * MOST_MEMBERS * GROUPS_AT_WORK <= REGISTERS
    assert built.stack <= MOST_STACK
    # The instruction; a function's name may have the word.
    assert not re.search(r"^\s*prefetch", built.ptx, re.MULTILINE)
    # The compiler has neither doubled nor dropped one.
    assert built.ptx.count("bar.warp.sync") == count_meetings()


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


def test_few_roads_have_larger_teams():
    from marl_lanes.traffic.gpu import _choose_team

    assert [_choose_team(number) for number in (1, 2112, 2113, 8192, 10**6)] == [32, 32, 16, 8, 8]


@pytest.mark.parametrize("size", [0, 3, 64, -1, None])
def test_a_team_is_a_part_of_a_group(size):
    from marl_lanes.traffic.gpu import GpuRoads

    with pytest.raises(
        ValueError, match=rf"^size = {size}: must be one of \(1, 2, 4, 8, 16, 32\)$"
    ):
        GpuRoads.form_teams(None, size)
