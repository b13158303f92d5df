"""Estimates of memory: what is too large is named, and what is made is not larger."""

import psutil
import pytest
import torch
from configs import typed
from learners import baseline

from marl_lanes import LaneChangeEnv, load_scenario
from marl_lanes.training.collected import load_collected
from marl_lanes.training.sizes import check_networks, check_sizes

PAPER = load_scenario("paper")
ROADS = 1_000_000_000


def check(*options, section=""):
    config = typed(*options)
    check_sizes(config, load_collected(PAPER, config.training_overrides), PAPER, section)


@pytest.mark.parametrize(
    ("option", "name"),
    [
        (f"collector.num_envs={ROADS}", "collector.num_envs"),
        (f"collector.steps_per_batch={ROADS}", "collector.steps_per_batch"),
        ("replay.capacity=1_000_000_000_000", "replay.capacity"),
        ("replay.batch_size=1_000_000_000_000", "replay.batch_size"),
        (f"evaluation.num_maneuvers={ROADS}", "evaluation.num_maneuvers"),
        (f"evaluation.final_num_maneuvers={ROADS}", "evaluation.final_num_maneuvers"),
    ],
)
def test_a_size_that_does_not_fit_is_named(option, name):
    value = int(option.partition("=")[2])
    with pytest.raises(ValueError, match=rf"^part.{name} = {value}: needs about .* must be at "):
        check(option, section="part.")


def test_what_is_small_passes():
    check()
    check("replay.capacity=1_000_000_000_000", "replay.storage=memmap")
    for widths in ([64, 64], [1], [512] * 8):
        check_networks(typed(), "network.hidden_sizes", widths, 9)


def test_workers_count_where_they_are_on_this_machine(monkeypatch):
    memory = type("Memory", (), {"available": 2**30})
    monkeypatch.setattr(psutil, "virtual_memory", lambda: memory)
    options = ["num_workers=8", "collector.num_envs=8", "replay.capacity=1000"]
    with pytest.raises(ValueError, match=r"^num_workers = 8: needs about 2.34 GiB of memory, 1 "):
        check("collector=multi", *options)
    check("collector=ray", *options)


def test_networks_that_do_not_fit_are_named():
    with pytest.raises(ValueError, match=r"^widths = \[1000000, 1000000\]: number of weights = "):
        check_networks(typed(), "widths", [1_000_000, 1_000_000], 6)
    config = typed("replay.batch_size=10_000_000")
    check_networks(config, "widths", [8], 6)
    with pytest.raises(ValueError, match=r"^part.replay.batch_size = 10000000: needs about"):
        check_networks(config, "widths", [65_536], 6, "part.")


def test_the_estimates_are_of_the_right_size(monkeypatch):
    """Of the roads and of a stored transition."""
    asked = {}
    name = "marl_lanes.training.sizes.check_memory"
    monkeypatch.setattr(name, lambda name, value, needed: asked.update({name: needed / value}))
    check("replay.rare_share=0.0")
    env = LaneChangeEnv(load_collected(PAPER, typed().training_overrides), 3)
    assert asked["collector.num_envs"] == env.simulator.bytes_per_environment
    # 6 features twice and an action, float32, and the rest of its columns.
    assert 76 <= asked["replay.capacity"] <= 200
    step = env.fake_tensordict()
    each = step.bytes() / 3
    assert each < asked["collector.steps_per_batch"] / 256 < 4 * each
    assert torch.get_default_dtype() == torch.float32


def test_the_batch_of_epochs_is_named_where_there_is_no_replay_buffer():
    learner = baseline("ippo")
    learner.collector.shutdown()
    config = learner.config
    check_sizes(config, PAPER, PAPER)
    epochs = config.epochs.model_copy(update={"batch_size": 10**12})
    large = config.model_copy(update={"epochs": epochs})
    with pytest.raises(ValueError, match=r"^epochs.batch_size = 1000000000000: needs about"):
        check_sizes(large, PAPER, PAPER)
    with pytest.raises(ValueError, match=r"^epochs.batch_size = 1000000000000: needs about"):
        check_networks(large, "network.hidden_sizes", [8], 6)


def test_the_state_of_the_roads_counts(monkeypatch):
    asked = {}
    name = "marl_lanes.training.sizes.check_memory"
    monkeypatch.setattr(name, lambda name, value, needed: asked.update({name: needed / value}))
    config = typed()
    check_sizes(config, PAPER, PAPER, has_state=True)
    env = LaneChangeEnv(PAPER, 3, seed=0, has_state=True)
    # Before a step and after it, and as much for each agent that may act.
    step = env.fake_tensordict()
    state = 2.0 * step["state"].nbytes / 3
    whole = asked["collector.steps_per_batch"] / config.collector.num_envs
    check_sizes(config, PAPER, PAPER)
    plain = asked["collector.steps_per_batch"] / config.collector.num_envs
    assert whole - plain == 2.0 * state * (1 + PAPER.num_slots)
