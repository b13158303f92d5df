"""The PettingZoo environment and road 0 of the TorchRL environment are the same road."""

from collections import Counter

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from marl_lanes import LaneChangeEnv, parallel_env
from marl_lanes.traffic.machine.state import Outcome

torch.set_num_threads(1)

SCENARIOS = ["paper", "curved", "five_lanes", "adversarial"]
KEYS = ("observation", "reward", "terminated", "truncated")


def steer(observation):
    """Feedback at most speeds, the largest action at the others, so that some commands fail."""
    speed, _, deviation, yaw, yaw_rate, curvature = observation[:6].tolist()
    if speed % 5.0 < 2.0:
        return np.float32(0.5)
    wanted = min(max(0.5 * deviation, -2.0), 2.0) / max(speed, 1.0)
    return np.float32(2.0 * (wanted - yaw) - 2.0 * (yaw_rate - curvature * speed))


class Roads:
    """Road 0 of the TorchRL environment in the form of the PettingZoo environment."""

    def __init__(self, scenario, num_envs, overrides):
        self.env = LaneChangeEnv(scenario, num_envs, overrides=overrides, seed=0)
        self.num_steps = 0

    def reset(self, seed):
        self.env.set_seed(seed)
        self.current = self.env.reset()
        self.is_over = False
        self.skip()
        return self.live("observation")

    def skip(self):
        """Step until an agent is live on road 0; agents on the other roads steer in every step."""
        while not self.is_over and not self.current["changers", "mask"][0].any():
            self.advance()

    def advance(self):
        group = self.current["changers"]
        action = torch.zeros(*group.shape, 1)
        for env, slot in group["mask"].nonzero().tolist():
            action[env, slot, 0] = steer(group["observation"][env, slot]).item()
        given = TensorDict({"changers": {"action": action}}, self.env.batch_size)
        after = self.env.step(given)["next"]
        self.num_steps += 1
        self.is_over = bool(after["done"][0])
        before, self.current = self.current, after
        return before["changers", "mask"][0] & after["changers", "done"][0, :, 0]

    def serial(self, slot):
        return f"changer_{self.env.simulator.agents['command'][0, slot]}"

    def live(self, key, ended=None):
        mask = self.current["changers", "mask"][0]
        slots = (mask if ended is None else mask | ended).nonzero()[:, 0].tolist()
        return {self.serial(slot): self.current["changers", key][0, slot].numpy() for slot in slots}

    def step(self):
        """The results of road 0 until an agent is live again, with PettingZoo's names."""
        ended = self.advance()
        parts = {key: self.live(key, ended) for key in KEYS}
        if not self.is_over and not self.current["changers", "mask"][0].any():
            self.skip()
            for key in KEYS:
                parts[key] |= self.live(key)
        return parts


def as_arrays(part, dtype):
    return {name: np.atleast_1d(np.asarray(value, dtype)) for name, value in part.items()}


def assert_same(part, expected):
    assert part.keys() == expected.keys()
    for name, value in part.items():
        assert value.dtype == expected[name].dtype
        assert value.tobytes() == expected[name].tobytes(), name


@pytest.mark.parametrize("num_envs", [1, 3])
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_both_give_the_same_episodes_step_by_step(scenario, num_envs):
    overrides = {"num_agents": 5, "departures": {"interval": [3.0, 6.0]}}
    if num_envs > 1:
        overrides["observation"] = {"num_stacked": 3, "grid": {}}
    single = parallel_env(scenario, overrides=overrides, seed=0)
    roads = Roads(scenario, num_envs, overrides)
    outcomes, num_steps = Counter(), 0
    for seed in (0, 11):
        observations, _ = single.reset(seed=seed)
        assert_same(roads.reset(seed), observations)
        while single.agents:
            actions = {name: [steer(observations[name])] for name in single.agents}
            observations, rewards, terminations, truncations, infos = single.step(actions)
            num_steps += 1
            parts = roads.step()
            assert_same(parts["observation"], observations)
            assert_same(parts["reward"], as_arrays(rewards, np.float32))
            assert_same(parts["terminated"], as_arrays(terminations, np.bool_))
            assert_same(parts["truncated"], as_arrays(truncations, np.bool_))
            assert roads.is_over == (not single.agents)
            same = single.simulator.vehicles[0].tobytes()
            assert same == roads.env.simulator.vehicles[0].tobytes()
            outcomes.update(info["outcome"] for info in infos.values() if info["outcome"])
    assert roads.num_steps > num_steps > 100
    assert outcomes.total() == 10
    assert outcomes[Outcome.COMPLETED] > 0
    assert len(outcomes) > 1


def test_other_actions_are_other_episodes():
    single, roads = parallel_env(seed=0), Roads("paper", 1, None)
    single.reset(seed=0)
    roads.reset(0)
    for _ in range(60):
        single.step({name: [0.05] for name in single.agents})
        roads.step()
    assert single.state().tobytes() != b""
    same = single.simulator.vehicles[0].tobytes()
    assert same != roads.env.simulator.vehicles[0].tobytes()
