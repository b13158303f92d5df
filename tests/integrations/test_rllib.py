"""RLlib's environment: an episode ends when it is over, not when nobody is live for a moment."""

import numpy as np
import pytest

pytest.importorskip("tree", reason="RLlib is not installed")
rllib = pytest.importorskip("marl_lanes.integrations.rllib")


def test_an_episode_lasts_until_its_last_command():
    env = rllib.LaneChangeMultiAgentEnv(
        {"scenario": "dense", "overrides": {"num_agents": 4, "command": {"probability": 1.0}}}
    )
    seen, _ = env.reset(seed=0)
    born, done = set(seen), set()
    while True:
        assert set(env.agents) <= set(seen)
        before = set(born)
        seen, _, terminated, truncated, _ = env.step({name: np.zeros(1) for name in env.agents})
        born |= set(seen)
        done |= {n for n in seen if terminated[n] or truncated[n]}
        is_over = terminated["__all__"] or truncated["__all__"]
        assert is_over == (len(done) == 4)
        assert before <= born
        if is_over:
            break
    assert not truncated["__all__"]
    assert born == set(env.possible_agents)
