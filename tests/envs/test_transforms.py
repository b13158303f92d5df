"""Normalised tensors against PettingZoo's normalised numbers, and the specs."""

import numpy as np
import torch
from torchrl.envs.utils import check_env_specs

from marl_lanes import LaneChangeEnv, parallel_env
from marl_lanes.envs.transforms import normalise

torch.set_num_threads(1)


def test_both_environments_are_normalised_in_the_same_way():
    overrides = {"num_agents": 2, "command": {"probability": 1.0}}
    road = parallel_env("interactive", normalised=True, overrides=overrides, seed=0)
    roads = normalise(LaneChangeEnv("interactive", overrides=overrides, seed=0))
    road.reset()
    current = roads.reset()
    while not current["changers", "mask"].any():
        current = roads.step(current.update(roads.full_action_spec.zero()))["next"]
    rng = np.random.default_rng(0)
    for _ in range(40):
        slots = current["changers", "mask"][0].nonzero()[:, 0].tolist()
        if len(slots) != len(road.agents):
            break
        action = torch.zeros(1, roads.base_env.simulator.num_slots, 2)
        actions = {agent: rng.uniform(-1.2, 1.2, 2).astype(np.float32) for agent in road.agents}
        commands = roads.base_env.simulator.agents["command"][0].tolist()
        for slot in slots:
            action[0, slot] = torch.from_numpy(actions[f"changer_{commands[slot]}"])
        current = roads.step(current.set(("changers", "action"), action))["next"]
        seen = road.step(actions)[0]
        for slot in slots:
            row = seen[f"changer_{commands[slot]}"]
            found = current["changers", "observation"][0, slot].numpy()
            np.testing.assert_allclose(found, row, rtol=1e-4, atol=1e-4)
    assert road.simulator.roads["step"][0] == roads.base_env.simulator.roads["step"][0] > 20


def test_the_specs_are_those_of_what_it_returns():
    roads = normalise(LaneChangeEnv("interactive", 2, seed=0, learned_followers=True))
    check_env_specs(roads)
    for group in ("changers", "followers"):
        space = roads.full_action_spec[group, "action"].space
        assert (space.low.unique().item(), space.high.unique().item()) == (-1.0, 1.0)
