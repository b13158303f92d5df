"""DDPG: its target, what an update changes, and that a learner trains, saves and resumes it."""

from functools import partial

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

make = partial(baseline, "ddpg")


@pytest.fixture
def algorithm():
    """With two actions, of different ranges, one not about zero."""
    made = make("loss.gamma=0.9", "optimizer.final_rate=0.5", overrides=TWO_ACTIONS)
    yield made.algorithm
    made.collector.shutdown()


def test_the_loss_is_that_of_the_source(algorithm):
    """What ends without a successor has the reward alone; what is cut off keeps its value."""
    for number in range(3):
        algorithm.take_step(transitions(algorithm), number)
    batch = transitions(algorithm)
    loss, following = algorithm.loss, batch["next"]
    with torch.no_grad():
        with loss.target_actor_network_params.to_module(loss.actor_network):
            action = loss.actor_network.module(following["observation"])
        with loss.target_value_network_params.to_module(loss.value_network):
            value = loss.value_network.module(following["observation"], action)
        with loss.value_network_params.to_module(loss.value_network):
            found = loss.value_network.module(batch["observation"], batch["action"])
        target = following["reward"] + 0.9 * ~following["terminated"] * value
    wanted = (found - target).square().mean().item()
    assert algorithm.take_step(batch, 4)["loss"].item() == pytest.approx(wanted, rel=1e-5)


def test_an_update_changes_critic_actor_and_targets(algorithm):
    before = state(algorithm)
    assert set(algorithm.take_step(transitions(algorithm), 1)) == {"loss", "actor_loss"}
    after = state(algorithm)
    for part in ("value", "actor", "target_value", "target_actor"):
        assert is_changed(before, after, part), part


def test_the_actor_climbs_the_critic(algorithm):
    batch = transitions(algorithm)
    before = algorithm.take_step(batch, 1)["actor_loss"].item()
    # The critic stands still.
    algorithm.optimizer.param_groups[0]["lr"] = 0.0
    for _ in range(20):
        after = algorithm.take_step(batch, 1)["actor_loss"].item()
    assert after < before


def test_step_sizes_and_noise_fall(algorithm):
    rates = algorithm.rates
    algorithm.anneal(150)
    found = [group["lr"] for group in algorithm.optimizer.param_groups]
    assert found == pytest.approx([0.75 * rate for rate in rates])
    config = algorithm.config.exploration
    middle = (config.initial_sigma + config.final_sigma) / 2.0
    assert algorithm.schedules()["sigma"] == pytest.approx(middle)


@pytest.mark.training
def test_a_training_that_is_resumed_is_the_same(tmp_path):
    metrics = check_resuming(tmp_path, make)
    assert list(metrics[0])[2:5] == ["loss", "actor_loss", "sigma"]
    assert float(metrics[-1]["loss"]) > 0.0
