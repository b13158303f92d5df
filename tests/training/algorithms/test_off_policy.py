"""What algorithms with an actor and critics share: their parts learn apart, within a norm."""

import pytest
import torch
from learners import baseline, state, transitions

from marl_lanes.training.transitions import live_transitions

torch.set_num_threads(1)


@pytest.mark.parametrize("name", ["td3", "ddpg", "sac"])
def test_one_part_learns_without_the_others(name):
    learner = baseline(name, "optimizer.max_gradient_norm=0.001")
    learner.collector.shutdown()
    algorithm = learner.algorithm
    parts = (algorithm.critic_parameters, algorithm.actor_parameters)
    before = [[one.detach().clone() for one in part] for part in parts]
    target = transitions(algorithm)["observation"]
    loss = 1e3 * algorithm.network(target).square().sum()
    algorithm.descend(loss, parts[1])
    norm = torch.stack([one.grad.norm() for one in parts[1] if one.grad is not None]).norm()
    assert norm == pytest.approx(0.001, rel=1e-3)
    same = [all(map(torch.equal, old, new)) for old, new in zip(before, parts, strict=True)]
    assert same == [True, False]


@pytest.mark.parametrize("name", ["td3", "ddpg", "sac"])
def test_targets_follow_by_tau(name):
    learner = baseline(name, "loss.tau=0.25")
    learner.collector.shutdown()
    algorithm = learner.algorithm
    before = state(algorithm)
    algorithm.take_step(transitions(algorithm), 2)
    after = state(algorithm)
    targets = [key for key in after if key.startswith("target_") and "layers" in key]
    assert targets
    for key in targets:
        source = after[key.removeprefix("target_")]
        wanted = before[key] + 0.25 * (source - before[key])
        assert torch.allclose(after[key], wanted, atol=1e-7), key


@pytest.mark.parametrize("name", ["td3", "ddpg", "sac"])
def test_a_target_over_several_steps(name):
    """The value after three steps counts as one after a single step at the cube of gamma."""
    losses = []
    for gamma in (0.5, 0.125):
        learner = baseline(name, "loss.num_steps=3", f"loss.gamma={gamma}")
        algorithm = learner.algorithm
        torch.manual_seed(4)
        batch = transitions(algorithm)
        if gamma == 0.5:
            batch["steps_to_next_obs"] = torch.full((len(batch), 1), 3)
            policy = learner.collector.policy
            collected = learner.env.rollout(60, policy, break_when_any_done=False)
            rows = algorithm.take_in(collected)
            assert rows["steps_to_next_obs"].max() == 3
            wanted = live_transitions(collected, num_steps=3, gamma=0.5)
            assert torch.equal(rows["next", "reward"], wanted["next", "reward"])
        learner.collector.shutdown()
        torch.manual_seed(5)
        losses.append(algorithm.take_step(batch, 1)["loss"].item())
    assert losses[0] == pytest.approx(losses[1], rel=1e-5)
