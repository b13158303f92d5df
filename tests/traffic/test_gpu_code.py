"""What CUDA's compiler made of the step drives the roads as the CPU's code does; on the CPU."""

import inspect

import numpy as np
import pytest
from devices import LONGITUDINAL, assert_same, draw
from gpu_compiler import CAPABILITIES, build, compile_ptx, kernel_arguments
from ptx_in_c import UnknownError
from ptx_kernel import CpuKernel, flatten, needs_c

from marl_lanes import Simulator, list_scenarios
from marl_lanes.traffic.machine.team import MOST_MEMBERS, any_member, meet, member, most
from marl_lanes.traffic.readout import changer_columns, follower_columns, read_changers
from marl_lanes.traffic.readout import read_followers as read_followers_here

NUM_ROADS = 5
NUM_STEPS = 1000
TEAM_SIZES = 8, 4, 32, 2, 16, 1

pytestmark = [pytest.mark.slow, needs_c]


def translate(name, folder):
    """A kernel as a GPU runs it, on the CPU."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        built = build(*kernel_arguments(name), monkeypatch, CAPABILITIES[1])
    return CpuKernel(built.ptx, folder)


@pytest.fixture(scope="module")
def advance(tmp_path_factory):
    return translate("advance", tmp_path_factory.mktemp("advance"))


def on_gpu_code(simulator, kernel, team_size, order):
    """Let teams of threads advance the simulator's roads."""
    roads = simulator._roads
    block = team_size, MOST_MEMBERS // team_size

    def run(mode, mask, num_steps):
        given = (mode, num_steps, np.zeros(1, np.int64), mask, *roads._arguments)
        kernel(-(-len(mask) // block[1]), block, list(flatten(given)), order)

    roads._run = run
    return simulator


def make_both(kernel, scenario, *, team_size=8, order=3, **options):
    here, there = (
        Simulator(scenario, NUM_ROADS, seed=5, num_threads=1, **options) for _ in range(2)
    )
    both = here, on_gpu_code(there, kernel, team_size, order)
    for simulator in both:
        simulator.reset()
    assert_same(*both)
    return both


def drive(rng, both, num_steps, *, has_followers=False):
    for _ in range(num_steps):
        actions = draw(rng, both[0])
        followers = rng.uniform(-4.0, 4.0, (*actions.shape[:2], 1)) if has_followers else None
        for simulator in both:
            simulator.step(actions, followers)


@pytest.mark.parametrize("longitudinal", [None, LONGITUDINAL], ids=["lateral", "both"])
@pytest.mark.parametrize("scenario", list_scenarios())
def test_every_scenario_after_a_thousand_steps(scenario, longitudinal, advance):
    overrides = {
        "action": {"longitudinal": longitudinal},
        "num_agents": None,
        "horizon": None,
        "command": {"probability": 1.0},
    }
    number = list_scenarios().index(scenario)
    size = TEAM_SIZES[number % len(TEAM_SIZES)]
    both = make_both(advance, scenario, team_size=size, order=number, overrides=overrides)
    drive(np.random.default_rng(1), both, NUM_STEPS)
    assert_same(*both)
    here = both[0]
    assert here.roads["num_commands"].sum() > NUM_ROADS
    assert here.roads["num_off_road"].sum() > 0
    assert (here.agents["episode_reward"] != 0.0).any()


def test_masked_resets_ends_of_episodes_and_waiting_for_an_agent(advance):
    both = make_both(advance, "dense", overrides={"horizon": 60.0, "command": {"probability": 1.0}})
    rng = np.random.default_rng(2)
    for _ in range(10):
        drive(rng, both, 70)
        mask = rng.random(NUM_ROADS) < 0.4
        for simulator in both:
            simulator.reset(mask)
        assert_same(*both)
        assert (both[0].roads["step"][mask] == 0).all()
    for simulator in both:
        simulator.reset()
        simulator.advance_until_live()
    assert_same(*both)


def test_collisions_and_drivers_that_move_over(advance):
    overrides = {"command": {"probability": 1.0}, "num_agents": None, "horizon": None}
    both = make_both(advance, "yielding", team_size=4, overrides=overrides)
    drive(np.random.default_rng(6), both, NUM_STEPS)
    assert_same(*both)
    assert both[0].roads["num_collisions"].sum() > 0
    assert both[0].roads["num_moves_over"].sum() > 0


def test_learned_followers(advance, tmp_path):
    both = make_both(advance, "interactive", learned_followers=True)
    drive(np.random.default_rng(3), both, NUM_STEPS // 2, has_followers=True)
    assert_same(*both)
    here = both[0]
    assert here.is_follower_acting.any()
    read_out(here, tmp_path)


def test_only_the_time_depends_on_the_team(advance):
    overrides = {"command": {"probability": 1.0}, "num_agents": None, "horizon": None}
    states = []
    for size, order in (8, 1), (32, 2), (1, 0):
        simulator = on_gpu_code(
            Simulator("yielding", NUM_ROADS, seed=5, num_threads=1, overrides=overrides),
            advance,
            size,
            order,
        )
        simulator.reset()
        drive(np.random.default_rng(4), [simulator], NUM_STEPS // 4)
        states.append(simulator.state.tobytes())
    assert states[0] == states[1] == states[2]


def read_out(simulator, folder):
    """What the kernels that surround the step read is what the CPU's functions read."""
    flat = simulator.agents.shape
    ends = [np.empty((flat[0], 1), np.bool_) for _ in range(3)]
    columns = changer_columns(flat)
    given = simulator.state.agents, True, *columns.values(), simulator.state.roads, *ends
    translate("read_changers", folder)(1, (flat[0] * flat[1], 1), list(flatten(given)))
    expected = read_changers(simulator.agents, has_longitudinal=True)
    for name, column in columns.items():
        np.testing.assert_array_equal(column, expected[name])
    assert ends[0][:, 0].tolist() == (simulator.roads["is_done"] != 0).tolist()
    columns = follower_columns(flat)
    given = simulator.agents, simulator.state.followers, simulator.learner, *columns.values()
    translate("read_followers", folder)(1, (flat[0] * flat[1], 1), list(flatten(given)))
    expected = read_followers_here(
        simulator.agents, simulator.state.followers, policy=simulator.learner
    )
    assert expected["acting"].any()
    for name, column in columns.items():
        np.testing.assert_array_equal(column, expected[name])


def add(numbers, found):
    found[member()] = most(numbers[member()])
    if any_member(numbers[member()] < 0.0):
        found[member()] += 1.0


def part(numbers, found):
    if numbers[member()] < 0.0:
        meet()
    found[0] = 1.0


def leave(numbers, found):
    if numbers[member()] < 0.0:
        return
    found[0] = 1.0
    meet()


def run_small(function, numbers, folder, monkeypatch):
    numbers, found = np.array(numbers), np.zeros(len(numbers))
    ptx = compile_ptx(function, (numbers, found), monkeypatch)
    CpuKernel(ptx, folder)(1, (len(numbers), 1), list(flatten((numbers, found))), 1)
    return found.tolist()


def test_members_vote_and_exchange(tmp_path, monkeypatch):
    numbers = [1.5, 4.25, -3.0, 1e300]
    assert run_small(add, numbers, tmp_path, monkeypatch) == [1e300 + 1.0] * 4
    assert run_small(add, [1.5, 4.25], tmp_path, monkeypatch) == [4.25] * 2


@pytest.mark.parametrize("function", [part, leave])
def test_members_that_do_not_find_together_are_told(function, tmp_path, monkeypatch):
    with pytest.raises(RuntimeError, match="a thread has left"):
        run_small(function, [1.0, -1.0], tmp_path, monkeypatch)


def test_what_is_not_translated_is_told(tmp_path):
    lines = ".reg .b32 %r<3>;", "brev.b32 %r1, %r2;", "ret;"
    ptx = "\n".join([".visible .entry some(", ".param .u64 one", ")", "{", *lines, "}"])
    with pytest.raises(UnknownError, match=r"brev\.b32"):
        CpuKernel(ptx, tmp_path)


def test_as_many_numbers_as_parameters(advance):
    kernel = inspect.signature(advance.__call__)
    assert list(kernel.parameters) == ["grid", "block", "numbers", "order"]
    with pytest.raises(ValueError, match="1 numbers for 163 parameters"):
        advance(1, (8, 4), [0])
