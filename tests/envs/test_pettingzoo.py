"""PettingZoo's own tests, its wrappers and the agents' turns, in whole episodes."""

import warnings

import numpy as np
import pytest
import torch
from envs.playing import LONG, hold, transcript

from marl_lanes import env, parallel_env

with warnings.catch_warnings():
    # With pygame installed, PettingZoo's tests import one of its games in a deprecated way.
    warnings.filterwarnings("ignore", "The old environment creation API", DeprecationWarning)
    from pettingzoo.test import (
        api_test,
        parallel_api_test,
        parallel_seed_test,
        performance_benchmark,
        seed_test,
    )

from pettingzoo.utils import BaseParallelWrapper
from pettingzoo.utils.conversions import aec_to_parallel
from pettingzoo.utils.wrappers import ClipOutOfBoundsWrapper, OrderEnforcingWrapper

torch.set_num_threads(1)


@pytest.mark.parametrize("scenario", ["paper", "dense", "five_lanes"])
def test_it_passes_the_parallel_api_test(scenario):
    parallel_api_test(parallel_env(scenario, seed=0), num_cycles=LONG)


@pytest.mark.parametrize("scenario", ["paper", "dense"])
def test_its_aec_form_passes_the_api_test(scenario):
    api_test(env(scenario, seed=0), num_cycles=1000)


def test_it_passes_the_tests_without_a_seed():
    parallel_api_test(parallel_env(), num_cycles=LONG)
    api_test(env(overrides={"horizon": 40.0}), num_cycles=200)


def test_it_passes_the_seed_tests():
    seed_test(env)
    parallel_seed_test(parallel_env)


@pytest.mark.slow
def test_its_aec_form_runs_the_performance_benchmark(capsys):
    performance_benchmark(env(seed=0))
    assert "Finished performance benchmark" in capsys.readouterr().out


def test_pettingzoos_wrappers_change_nothing():
    plain = transcript(parallel_env("dense", overrides={"num_agents": 3}), hold, seed=2)
    wrapped = BaseParallelWrapper(parallel_env("dense", overrides={"num_agents": 3}))
    assert transcript(wrapped, hold, seed=2) == plain
    cycle = OrderEnforcingWrapper(ClipOutOfBoundsWrapper(env("dense", overrides={"num_agents": 3})))
    back = aec_to_parallel(cycle)
    back.reset(seed=2)
    road = parallel_env("dense", overrides={"num_agents": 3})
    road.reset(seed=2)
    while len(road.agents) == 1:
        actions = {agent: np.full(1, 0.1, np.float32) for agent in road.agents}
        assert back.agents == road.agents
        back.step(actions)
        road.step(actions)
        assert back.state().tobytes() == road.state().tobytes()
    assert road.simulator.roads["step"][0] > 0


def test_the_aec_form_is_used_in_every_order():
    cycle = env("dense", seed=0, overrides={"num_agents": 3})
    with pytest.raises(AttributeError, match="cannot be accessed before reset"):
        cycle.agent_selection  # noqa: B018
    with pytest.raises(AssertionError):
        cycle.step(hold(None))
    for _ in range(2):
        # A reset in the middle of a cycle begins anew.
        cycle.reset(seed=4)
        seen = cycle.last()[0].tobytes()
        for _ in range(7):
            cycle.step(hold(None))
    cycle.reset(seed=4)
    assert cycle.last()[0].tobytes() == seen
    for agent in cycle.agent_iter():
        _, _, terminated, truncated, info = cycle.last()
        cycle.step(None if terminated or truncated else hold(None))
        assert agent.startswith("changer_")
        assert "phase" in info or truncated or terminated or not info
    assert not cycle.agents
    last = cycle.unwrapped.simulator.snapshot()
    cycle.step(None)
    assert cycle.unwrapped.simulator.snapshot() == last
    cycle.close()
    cycle.close()
    cycle.reset(seed=4)
    assert cycle.last()[0].tobytes() == seen


def test_a_refused_action_of_the_aec_form_leaves_the_road():
    cycle = env("dense", seed=0)
    cycle.reset()
    before = cycle.unwrapped.simulator.snapshot()
    with pytest.raises(ValueError, match=r"^actions\['changer_0'\]: shape \(2,\), must be \(1,\)$"):
        cycle.step(np.zeros(2))
    assert cycle.unwrapped.simulator.snapshot() == before
    cycle.step(np.zeros(1))
    assert cycle.unwrapped.simulator.snapshot() != before
