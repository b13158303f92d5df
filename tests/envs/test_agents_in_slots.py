"""Agents in the slots of the TorchRL environment: masks, rewards, and how they and roads end."""

import pytest
import torch
from envs.rolling import BUSY, LONG, SHORT, assert_equal, feedback, hold, policy, roll, steer
from tensordict.nn import TensorDictModule
from torchrl.envs import RewardSum, TransformedEnv

from marl_lanes import LaneChangeEnv, parallel_env
from marl_lanes.traffic.machine.state import Outcome

torch.set_num_threads(1)


def _steer_badly(observation):
    """Feedback at most speeds, the largest action to one side at the others."""
    return torch.where(observation[..., :1] % 5.0 < 2.0, 0.5, feedback(observation))


@pytest.fixture(scope="module")
def busy():
    """Two roads without end, their three slots in steady use; many changes fail."""
    careless = {"rule": "kinematic", "minimum_gap": 0.0, "time_gap": 0.0}
    env = LaneChangeEnv("adversarial", 2, overrides={**BUSY, "gap": careless}, seed=3)
    return roll(env, 1500, policy(_steer_badly))


def test_slots_serve_one_command_after_the_other(busy):
    mask, after = busy["changers", "mask"], busy["next", "changers", "mask"]
    done = busy["next", "changers", "done"].squeeze(-1)
    assert (done <= mask).all()
    assert not (done & after).any()
    assert torch.equal(mask & ~done, mask & after)
    assert torch.equal(mask[:, 1:], after[:, :-1])
    # In the step after an end the slot is absent and its flags are False.
    assert not (done[:, 1:] & done[:, :-1]).any()
    assert not (after[:, :-1] & done[:, :-1]).any()
    assert done.sum(1).min() >= 2
    births = (after & ~mask).sum(1)
    assert ((births - done.sum(1)).abs() <= 1).all()


def test_absent_slots_are_zero_and_the_ended_keep_their_last_features(busy):
    mask, group, after = busy["changers", "mask"], busy["changers"], busy["next", "changers"]
    done = after["done"].squeeze(-1)
    is_there = after["mask"] | done
    assert not after["observation"][~is_there].any()
    # Speeds are never 0 on this road, so a live agent's observation is not zero.
    assert (after["observation"][is_there][:, 0] > 0.0).all()
    for key in ("steering", "outcome"):
        assert not group[key][~mask & ~(group["outcome"] > 0)].any()
        assert not after[key][~is_there].any()
    assert not after["reward"][~mask].any()
    moved = (after["observation"] - group["observation"])[done]
    assert (moved[:, 2].abs() < 1.0).all()


def test_only_steering_agents_are_rewarded(busy):
    engaged, mask = busy["changers", "steering"], busy["changers", "mask"]
    reward = busy["next", "changers", "reward"].squeeze(-1)
    outcome = busy["next", "changers", "outcome"]
    assert (engaged <= mask).all()
    assert (mask & ~engaged).any()
    is_failure = (outcome == Outcome.COLLISION) | (outcome == Outcome.OFF_ROAD)
    assert not reward[~engaged & ~is_failure].any()
    assert (reward[is_failure] <= -10.0).all()
    assert (reward[~is_failure] > -10.0).all()
    assert (reward[engaged] < 0.0).float().mean() > 0.99


def test_the_command_reward_starts_again_with_each_command(busy):
    mask, before = busy["changers", "mask"], busy["changers", "command_reward"]
    after, reward = busy["next", "changers", "command_reward"], busy["next", "changers", "reward"]
    is_newborn = busy["next", "changers", "mask"] & ~mask
    assert not after[is_newborn].any()
    assert is_newborn.sum() > 10
    torch.testing.assert_close(after[mask], (before + reward)[mask], rtol=1e-5, atol=1e-5)
    assert (before[mask] < -1.0).any()


def test_torchrls_reward_sum_stands_beside_the_command_reward():
    plain, summing = (LaneChangeEnv("dense", 1, seed=0, overrides=SHORT) for _ in range(2))
    steps = roll(TransformedEnv(summing, RewardSum(in_keys=summing.reward_keys)), 100)
    assert_equal(
        steps["next", "changers"].exclude("episode_reward"), roll(plain, 100)["next", "changers"]
    )
    changers = steps["next", "changers"]
    torch.testing.assert_close(changers["episode_reward"], changers["reward"].cumsum(1))


def test_outcomes_end_the_agents_as_they_should(busy):
    after = busy["next", "changers"]
    outcome = after["outcome"]
    terminating = [Outcome.COMPLETED, Outcome.COLLISION, Outcome.OFF_ROAD]
    terminated = torch.isin(outcome, torch.tensor([int(value) for value in terminating]))
    assert torch.equal(after["terminated"].squeeze(-1), terminated)
    assert torch.equal(after["truncated"].squeeze(-1), outcome == Outcome.MISSED)
    assert torch.equal(after["done"], after["terminated"] | after["truncated"])
    assert set(terminating) <= set(outcome.unique().tolist())
    assert not busy["next", "done"].any()


def test_a_missed_command_is_truncated():
    env = LaneChangeEnv(
        "dense", 1, overrides={"gap": {"minimum_gap": 500.0}, "num_agents": 2}, seed=0
    )
    steps = env.rollout(LONG, hold)
    after = steps["next", "changers"]
    ends = after["done"].squeeze(-1)
    assert after["outcome"][ends].tolist() == [Outcome.MISSED] * 2
    assert after["truncated"][ends].all()
    assert not after["terminated"].any()
    assert not steps["changers", "steering"].any()
    # The road's episode is over because all its commands are finished.
    assert bool(steps["next", "terminated"][0, -1])
    assert not steps["next", "truncated"].any()


def test_the_last_command_terminates_a_road():
    env = LaneChangeEnv("paper", 1, overrides=SHORT, seed=0)
    steps = env.rollout(LONG, steer)
    done = steps["next", "done"].flatten()
    assert done.tolist() == [False] * (len(done) - 1) + [True]
    assert torch.equal(steps["next", "terminated"], steps["next", "done"])
    assert not steps["next", "truncated"].any()
    assert steps["next", "changers", "done"].sum() == 2
    assert steps["next", "changers", "done"][0, -1].any()


def test_the_horizon_truncates_agents_and_road():
    env = LaneChangeEnv("paper", 2, overrides={**BUSY, "horizon": 30.0}, seed=0)
    steps = env.rollout(LONG, hold)
    assert steps.shape == (2, 300)
    last = steps[:, -1]
    live = last["changers", "mask"]
    is_cut = last["next", "changers", "outcome"] == Outcome.HORIZON
    assert is_cut.any(1).all()
    assert (is_cut <= live).all()
    assert last["next", "changers", "truncated"].squeeze(-1)[is_cut].all()
    assert not last["next", "changers", "terminated"].squeeze(-1)[is_cut].any()
    assert not last["next", "changers", "mask"].any()
    assert last["next", "truncated"].all()
    assert last["next", "done"].all()
    assert not last["next", "terminated"].any()
    assert not steps[:, :-1]["next", "done"].any()


def test_a_command_that_times_out_is_truncated_and_its_slot_is_used_again():
    """Also that of the learned follower beside it; the road goes on."""
    limit = {"command": {"probability": 1.0, "time_limit": 3.0}}
    overrides = {**BUSY, **limit, "num_slots": 2}
    env = LaneChangeEnv("dense", 2, overrides=overrides, learned_followers=True, seed=0)
    groups = ("changers", "followers")
    idle = TensorDictModule(
        lambda *observations: tuple(torch.zeros_like(seen[..., :1]) for seen in observations),
        [(group, "observation") for group in groups],
        [(group, "action") for group in groups],
    )
    steps = env.rollout(300, idle)
    is_over = steps["next", "changers", "outcome"] == Outcome.TIMED_OUT
    assert is_over.sum(1).min() > 2
    for group in groups:
        after = steps["next", group]
        assert torch.equal(after["done"].squeeze(-1), is_over)
        assert torch.equal(after["truncated"], after["done"])
        assert not after["terminated"].any()
        assert not after["mask"][is_over].any()
        rows = steps[group, "mask"].sum((1, 2)) - 30 * is_over.sum((1, 2))
        assert ((rows >= 0) & (rows <= 2 * 30)).all(), "each lives for 30 steps"
    assert not steps["next", "done"].any()


def test_an_episode_without_a_command_is_driven_here_and_skipped_by_pettingzoo():
    short = {"horizon": 20.0}
    single = parallel_env("paper", seed=0, overrides=short)
    roads = LaneChangeEnv("paper", 1, seed=0, overrides=short)
    num_empty = 0
    for _ in range(5):
        single.reset()
        assert single.agents
        steps = roads.rollout(200, hold)
        while not steps["changers", "mask"].any():
            assert bool(steps["next", "truncated"][0, -1])
            num_empty += 1
            steps = roads.rollout(200, hold)
        while single.agents:
            single.step({agent: [0.0] for agent in single.agents})
        same = single.simulator.roads["random_counter"] == roads.simulator.roads["random_counter"]
        assert same.all()
    assert num_empty > 1
