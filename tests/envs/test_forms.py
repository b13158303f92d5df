"""The forms of the PettingZoo environment, put together."""

import numpy as np
import pytest

from marl_lanes import env, parallel_env
from marl_lanes.envs.normalised import Normalised
from marl_lanes.envs.parallel import LaneChangeParallelEnv
from marl_lanes.envs.population import ConstantPopulation


def test_wrappers_are_as_asked_for():
    plain = parallel_env(seed=0)
    assert type(plain) is LaneChangeParallelEnv
    assert plain.unwrapped is plain
    assert type(parallel_env(seed=0, normalised=True)) is Normalised
    both = parallel_env(seed=0, normalised=True, population="constant")
    assert type(both) is ConstantPopulation
    assert type(both.env) is Normalised
    assert type(both.unwrapped) is LaneChangeParallelEnv
    with pytest.raises(TypeError, match="fixed_agents"):
        parallel_env(fixed_agents=True)


@pytest.mark.parametrize("population", ["live", "constant"])
def test_a_cycle_is_the_parallel_form_agent_by_agent(population):
    options = {"population": population, "overrides": {"num_agents": 2}, "seed": 0}
    cycle, road = env("dense", **options), parallel_env("dense", **options)
    cycle.reset()
    road.reset()
    for _ in range(30):
        assert cycle.agents == road.agents
        for _ in road.agents:
            cycle.step(np.zeros(1))
        observations = road.step({agent: np.zeros(1) for agent in road.agents})[0]
        agent = cycle.agents[0]
        assert cycle.observe(agent).tobytes() == observations[agent].tobytes()
    assert isinstance(cycle.unwrapped, LaneChangeParallelEnv)
