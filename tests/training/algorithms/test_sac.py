"""SAC: its target, its entropy, and that a learner trains, saves and resumes it."""

from functools import partial
from math import log

import pytest
import torch
from learners import (
    TWO_ACTIONS,
    baseline,
    check_resuming,
    is_changed,
    state,
    transitions,
)

torch.set_num_threads(1)
pytestmark = pytest.mark.filterwarnings(
    "ignore:Creating .* which inherits from WeightUpdaterBase:DeprecationWarning"
)

make = partial(baseline, "sac")


@pytest.fixture
def algorithm():
    """With two actions, of different ranges, one not about zero."""
    made = make("loss.gamma=0.9", overrides=TWO_ACTIONS)
    yield made.algorithm
    made.collector.shutdown()


def test_the_target_has_the_entropy_of_the_next_action(algorithm):
    for number in range(3):
        algorithm.take_step(transitions(algorithm), number)
    batch = transitions(algorithm)
    loss, following = algorithm.loss, batch["next"]

    def values(params, observation, action):
        found = []
        for critic in range(2):
            with params[critic].to_module(loss.qvalue_network):
                found.append(loss.qvalue_network.module(observation, action))
        return torch.stack(found)

    # What the loss draws first.
    torch.manual_seed(5)
    with torch.no_grad():
        with loss.actor_network_params.to_module(loss.actor_network):
            action, log_prob = loss.actor_network.get_dist(following).rsample_and_log_prob()
        lowest = values(loss.target_qvalue_network_params, following["observation"], action).amin(0)
        soft = lowest - loss.log_alpha.exp() * log_prob.unsqueeze(-1)
        target = following["reward"] + 0.9 * ~following["terminated"] * soft
        found = values(loss.qvalue_network_params, batch["observation"], batch["action"])
    wanted = (found - target).square().sum(0).mean().item()
    torch.manual_seed(5)
    assert algorithm.take_step(batch, 4)["loss"].item() == pytest.approx(wanted, rel=1e-4)


def test_an_update_changes_everything_but_targets_of_the_actor(algorithm):
    before = state(algorithm)
    losses = algorithm.take_step(transitions(algorithm), 1)
    assert set(losses) == set(algorithm.columns)
    after = state(algorithm)
    for part in ("qvalue", "actor", "target_qvalue"):
        assert is_changed(before, after, part), part
    assert before["log_alpha"] != after["log_alpha"]


def test_alpha_rises_while_the_entropy_is_too_low(algorithm):
    """The target is that of the actions as shares of their half ranges, in the actions' units."""
    half_range = algorithm.network.box.half_range.tolist()
    wanted = sum(map(log, half_range)) + 2 * algorithm.config.loss.target_entropy
    assert float(algorithm.loss.target_entropy) == pytest.approx(wanted)
    batch = transitions(algorithm)
    for target, is_rising in ((wanted + 50.0, True), (wanted - 50.0, False)):
        algorithm.loss.target_entropy_buffer.fill_(target)
        before = algorithm.loss.log_alpha.item()
        for _ in range(30):
            algorithm.take_step(batch, 1)
        assert (algorithm.loss.log_alpha.item() > before) == is_rising


def test_it_acts_within_the_box_and_greedily_without_its_distribution(algorithm):
    box = algorithm.network.box
    observation = transitions(algorithm, 4000)["observation"]
    sampler = algorithm.policy.module[0].policy
    with torch.no_grad():
        drawn, greedy = sampler(observation), algorithm.network(observation)
    assert ((drawn >= box.low) & (drawn <= box.high)).all()
    share = (drawn - greedy) / box.half_range
    sigma = algorithm.config.exploration.initial_sigma
    assert share.std(0)[0].item() == pytest.approx(sigma, rel=0.1)
    assert share.mean(0)[0].abs() < 0.1 * sigma


@pytest.mark.training
def test_a_training_that_is_resumed_is_the_same(tmp_path):
    metrics = check_resuming(tmp_path, make)
    assert list(metrics[0])[2:6] == ["loss", "actor_loss", "alpha", "entropy"]
    assert float(metrics[-1]["alpha"]) > 0.0
