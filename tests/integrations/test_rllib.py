"""RLlib's environment: no life is lost where RLlib ends an episode."""

import numpy as np
import pytest

from marl_lanes import parallel_env

pytest.importorskip("tree", reason="RLlib is not installed")
rllib = pytest.importorskip("marl_lanes.integrations.rllib")


def test_every_command_of_a_road_is_driven_to_its_end():
    options = {"scenario": "paper", "overrides": {"num_agents": 5, "horizon": None}, "seed": 3}
    env, plain = rllib.LaneChangeMultiAgentEnv(options), parallel_env(normalised=True, **options)
    seen, _ = plain.reset()
    ended, num_episodes = [], 0
    while len(ended) < 5:
        num_episodes += 1
        found, infos = env.reset()
        is_over = False
        while not is_over:
            assert set(found) == set(infos) >= set(env.agents)
            assert all(np.array_equal(found[name], seen[name]) for name in found)
            acting = {name: np.full(1, 0.1) for name in env.agents}
            assert set(acting) == set(plain.agents)
            found, rewards, terminated, truncated, infos = env.step(acting)
            seen, *_ = plain.step(acting)
            assert set(rewards) == set(found)
            over = [name for name in found if terminated[name] or truncated[name]]
            ended += over
            is_over = terminated["__all__"]
            assert is_over == (not set(env.agents))
            # RLlib ends an episode in which all agents that have acted are done.
            assert is_over == (set(acting) <= set(over))
    assert sorted(ended) == env.possible_agents
    assert num_episodes > 1
    assert not plain.agents
