"""What a batched environment takes of the memory, and the refusal of what does not fit."""

from types import SimpleNamespace

import psutil
import pytest

from marl_lanes import LaneChangeEnv, load_scenario
from marl_lanes.envs import batched
from marl_lanes.envs.sizes import bytes_of_batched_road


def test_more_roads_than_memory_are_refused_before_anything_is_made(monkeypatch):
    needed = 1000 * bytes_of_batched_road(
        load_scenario("paper"), has_followers=False, has_state=False
    )
    made = []
    allocate = batched.Simulator
    monkeypatch.setattr(batched, "Simulator", lambda *_, **__: made.append(1) or allocate)
    monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(available=needed - 1))
    with pytest.raises(ValueError, match=r"^num_envs = 1000: needs about .* at most 999 here$"):
        LaneChangeEnv("paper", 1000)
    assert not made


def test_the_estimate_of_memory_is_what_is_used():
    env = LaneChangeEnv("interactive", 64, seed=0, learned_followers=True, has_state=True)
    state = sum(array.nbytes for array in env.simulator.state.arrays)
    state += env.simulator.actions.nbytes + env.simulator.follower_actions.nbytes
    assert state == 64 * env.simulator.bytes_per_environment
    bounds = sum(
        env.full_observation_spec[group, "observation"].space.low.nbytes * 2
        + env.full_action_spec[group, "action"].space.low.nbytes * 2
        for group in env.group_map
    )
    used = state + bounds + env.rollout(1).bytes()
    estimate = 64 * bytes_of_batched_road(env.scenario, has_followers=True, has_state=True)
    assert used <= estimate < 1.2 * used
