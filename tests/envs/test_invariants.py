"""What both environments promise of every agent, in drawn scenarios with drawn actions."""

from collections import Counter, defaultdict
from itertools import accumulate

import numpy as np
import pytest
import torch
from drawn_scenarios import drawn, share_of
from hypothesis import assume, given
from tensordict import TensorDict

from marl_lanes import LaneChangeEnv, parallel_env
from marl_lanes.traffic.machine.state import Outcome

torch.set_num_threads(1)

NUM_STEPS = 100
TERMINATING = {Outcome.COMPLETED, Outcome.COLLISION, Outcome.OFF_ROAD}
ENDS = "done", "terminated", "truncated"


def options_of(case):
    """The arguments of both environments."""
    return {
        "seed": case.seed,
        "learned_followers": case.has_learner,
        "follower_policies": case.policies,
    }


def play_episode(case):
    """One episode in PettingZoo: every agent begins once and ends once; its outcomes."""
    road = parallel_env(case.scenario, **options_of(case))
    generator = np.random.default_rng(case.seed)
    observations, _ = road.reset()
    total, ends, seen = defaultdict(float), {}, set()
    while road.agents:
        before = list(road.agents)
        for agent, observation in observations.items():
            assert road.observation_space(agent).contains(observation), (agent, observation)
        seen.update(before)
        assert not seen & set(ends) & set(before)
        chosen = case.choose(road.simulator, generator)
        by_role = dict(zip(("changer", "follower"), chosen, strict=True))
        actions = {}
        for agent in before:
            role, serial = agent.split("_")
            slot = road.simulator.agents["command"][0].tolist().index(int(serial))
            actions[agent] = by_role[role][0, slot]
        observations, rewards, terminations, truncations, infos = road.step(actions)
        assert set(before) <= set(rewards)
        for agent, reward in rewards.items():
            terms = [value for name, value in infos[agent].items() if name.startswith("reward_")]
            # One after the other: from Python 3.12 on, sum() rounds once, at its end.
            *_, added = accumulate(terms)
            assert reward == added
            total[agent] += reward
            assert not (terminations[agent] and truncations[agent])
            is_over = terminations[agent] or truncations[agent]
            assert is_over == (agent not in road.agents)
            outcome = infos[agent].get("outcome")
            if outcome is not None:
                assert is_over == (outcome != Outcome.UNFINISHED)
                assert terminations[agent] == (outcome in TERMINATING)
            if is_over:
                assert agent not in ends
                ends[agent] = outcome
    seen.update(observations)
    assert set(ends) == seen
    return Counter(outcome for outcome in ends.values() if outcome is not None)


def play_batch(case):
    """A batch in TorchRL: all data inside the specs, each agent done once, when it ends."""
    env = LaneChangeEnv(case.scenario, 3, num_threads=1, **options_of(case))
    generator = np.random.default_rng(case.seed)
    current, totals = env.reset(), {}
    for _ in range(NUM_STEPS):
        assert env.observation_spec.is_in(current.select(*env.observation_keys))
        chosen = case.choose(env.simulator, generator)
        groups = {
            role.group: {"action": torch.from_numpy(action).float()}
            for role, action in zip(env.roles, chosen, strict=False)
        }
        after = env.step(TensorDict(groups, env.batch_size))["next"]
        assert env.observation_spec.is_in(after.select(*env.observation_keys))
        assert env.reward_spec.is_in(after.select(*env.reward_keys))
        assert env.full_done_spec.is_in(after.select(*env.done_keys))
        for role in env.roles:
            group, last = after[role.group], current[role.group]
            done, terminated, truncated = (group[name][..., 0] for name in ENDS)
            assert torch.equal(done, terminated ^ truncated)
            # The one that ends was live, and is so no more.
            assert not (done & ~last["mask"]).any()
            assert not (done & group["mask"]).any()
            before = totals.get(role.group, torch.zeros_like(group["command_reward"]))
            goes_on = last["mask"][..., None]
            totals[role.group] = torch.where(goes_on, before, 0.0) + group["reward"]
            is_paid = last["mask"] | group["mask"]
            paid, expected = totals[role.group][is_paid], group["command_reward"][is_paid]
            assert torch.allclose(paid, expected, rtol=1e-5, atol=1e-4)
        assert not (after["terminated"] & after["truncated"]).any()
        current = after
    return after["done"].sum().item()


def hold(number, *, is_whole):
    met = Counter()

    @share_of(number, is_whole=is_whole)
    @given(drawn())
    def keep(case):
        assume(case.scenario.command.probability > 0.0)
        met.update(play_episode(case.but(num_agents=4, horizon=40.0)))
        met["batch"] += play_batch(case)

    keep()
    return met


def test_what_is_promised_of_every_agent():
    hold(4, is_whole=False)


@pytest.mark.long
def test_what_is_promised_of_every_agent_in_hundreds_of_scenarios():
    met = hold(200, is_whole=True)
    assert met["batch"] > 0
    assert min(met[outcome] for outcome in Outcome if outcome != Outcome.UNFINISHED) > 0
