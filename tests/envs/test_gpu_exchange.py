"""LaneChangeEnv on a GPU gives what it gives on the CPU; left out where there is no GPU."""

import copy

import pytest
import torch
from devices import needs_gpu
from torchrl.envs.utils import check_env_specs

from marl_lanes import LaneChangeEnv

pytestmark = needs_gpu

SHORT = {"horizon": 20.0, "command": {"probability": 1.0}}


def make(device, scenario="interactive", **options):
    options = {"num_envs": 16, "seed": 3, "overrides": SHORT} | options
    return LaneChangeEnv(scenario, device=device, **options)


def assert_same(here, there):
    keys = set(here.keys(True, True))
    assert keys == set(there.keys(True, True))
    for key in keys:
        one, other = here[key], there[key]
        assert other.device.type == "cuda"
        assert (one.dtype, one.shape) == (other.dtype, other.shape)
        torch.testing.assert_close(other.cpu(), one, rtol=1e-5, atol=1e-5)


def drive(envs, num_steps, seed=0):
    """Every step of the first, and the other's, with their resets."""
    generator = torch.Generator().manual_seed(seed)
    now = [env.reset() for env in envs]
    assert_same(*now)
    for _ in range(num_steps):
        for group in envs[0].group_map:
            shape = envs[0].full_action_spec[group, "action"].shape
            action = torch.rand(shape, generator=generator) - 0.5
            for env, data in zip(envs, now, strict=True):
                data[group, "action"] = action.to(env.device)
        steps = [env.step_and_maybe_reset(data) for env, data in zip(envs, now, strict=True)]
        assert_same(steps[0][0]["next"], steps[1][0]["next"])
        now = [step[1] for step in steps]


@pytest.mark.parametrize("scenario", ["paper", "hidden"])
def test_rollouts_with_resets(scenario):
    drive([make("cpu", scenario), make("cuda", scenario)], 250)


def test_followers_and_the_table_of_vehicles():
    options = {"learned_followers": True, "has_state": True}
    drive([make("cpu", **options), make("cuda", **options)], 100)


def test_it_keeps_to_its_specs():
    check_env_specs(make("cuda", has_state=True))


def test_results_belong_to_the_caller():
    env = make("cuda")
    data = env.reset().update(env.full_action_spec.rand())
    first = env.step(data.copy())
    kept = first["next"].clone()
    for _ in range(30):
        last = env.step(data.copy())
    assert not torch.equal(last["next", "changers", "mask"], kept["changers", "mask"])
    assert_equal(first["next"], kept)


def assert_equal(one, other):
    for key in one.keys(True, True):
        assert torch.equal(one[key], other[key]), key


@pytest.mark.filterwarnings("ignore:Synchronization debug mode:UserWarning")
def test_a_step_does_not_wait():
    env = make("cuda")
    data = env.reset()
    data.update(env.full_action_spec.zero())
    env.step(data)
    torch.cuda.synchronize()
    try:
        torch.cuda.set_sync_debug_mode("error")
        env.step(data)
    finally:
        torch.cuda.set_sync_debug_mode("default")


def test_a_graph_of_steps():
    """Captured, replayed and read: the same as taken one by one."""
    graphed, plain = make("cuda", overrides={"horizon": None, "num_agents": None}), None
    data = graphed.reset()
    data.update(graphed.full_action_spec.zero())
    graphed.step(data.copy())
    torch.cuda.synchronize()
    plain = copy.deepcopy(graphed)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        result = graphed.step(data.copy())["next"]
    for _ in range(5):
        graph.replay()
        expected = plain.step(data.copy())["next"]
    assert_equal(result, expected)
    assert graphed.simulator.snapshot() == plain.simulator.snapshot()


def test_another_stream():
    envs = [make("cuda"), make("cuda")]
    data = [env.reset() for env in envs]
    for one, env in zip(data, envs, strict=True):
        one.update(env.full_action_spec.zero())
    torch.cuda.synchronize()
    stream = torch.cuda.Stream()
    for _ in range(20):
        here = envs[0].step(data[0].copy())
        with torch.cuda.stream(stream):
            there = envs[1].step(data[1].copy())
    torch.cuda.synchronize()
    assert_equal(here["next"], there["next"])


def test_an_action_that_is_not_finite_stops_the_roads():
    env = make("cuda")
    data = env.reset()
    while not data["changers", "acting"].any():
        data = env.step_mdp(env.step(data.update(env.full_action_spec.zero())))
    before = env.simulator.snapshot()
    data.update(env.full_action_spec.zero())
    data["changers", "action"][:] = torch.nan
    env.step(data.copy())
    with pytest.raises(ValueError, match=r"actions\[\d+, \d+, 0\]: must be a finite acceleration"):
        env.simulator.snapshot()
    assert env.simulator.snapshot() == before


def test_wrong_actions():
    env = make("cuda")
    data = env.reset()
    with pytest.raises(ValueError, match="action of the group 'changers': must be given"):
        env.step(data.copy())
    data["changers", "action"] = torch.zeros(16, env.simulator.num_slots, 7, device="cuda")
    with pytest.raises(ValueError, match=r"action of the group 'changers': shape .* must be"):
        env.step(data)


def test_a_copy_and_a_restored_one_go_on_alike():
    first = make("cuda")
    data = first.reset()
    data.update(first.full_action_spec.zero())
    for _ in range(50):
        first.step(data.copy())
    second, third = copy.deepcopy(first), make("cpu")
    third.restore(first.simulator.snapshot())
    here = first.step(data.copy())["next"]
    assert_equal(here, second.step(data.copy())["next"])
    assert_same(third.step(data.cpu().copy())["next"], here)
    assert first.simulator.snapshot() == second.simulator.snapshot()
