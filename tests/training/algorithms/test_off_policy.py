"""What algorithms with an actor and critics share: their parts learn apart, within a norm."""

import pytest
import torch
from learners import baseline, state, transitions

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
