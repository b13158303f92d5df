"""The command line: overrides, choices of files, and what is refused."""

import shlex
import sys

import pytest
import yaml
from configs import FOLDER, resolve, select, typed

from marl_lanes.training.algorithms.naf import TrainingConfig
from marl_lanes.training.command_line import (
    compose_fields,
    describe_command,
    read_command_line,
)
from marl_lanes.training.config import ConfigError


@pytest.mark.parametrize(
    ("override", "name", "value"),
    [
        ("loss.gamma=0.5", "loss.gamma", 0.5),
        ("loss.gamma=1", "loss.gamma", 1.0),
        ("seed=0", "seed", 0),
        ("output=2024", "output", "2024"),
        ("initial_checkpoint=a/b.pt", "initial_checkpoint", "a/b.pt"),
        ("network.mu=damped", "network.mu", "damped"),
        ("network.hidden_sizes=[3]", "network.hidden_sizes", [3]),
        ("optimizer.max_gradient_norm=null", "optimizer.max_gradient_norm", None),
        ("optimizer.max_gradient_norm=2", "optimizer.max_gradient_norm", 2.0),
        ("optimizer.pretraining_transitions=0", "optimizer.pretraining_transitions", 0),
        ("exploration.initial_sigma=0.2", "exploration.initial_sigma", 0.2),
        ("+training_overrides.road.num_lanes=5", "training_overrides.road.num_lanes", 5),
    ],
)
def test_every_field_can_be_set(override, name, value):
    found = select(typed(override).model_dump(), name)
    assert found == value
    assert type(found) is type(value) or isinstance(value, list)


@pytest.mark.parametrize("kind", ["single", "multi", "ray"])
def test_collector_is_chosen_by_one_word(kind):
    number = 1 if kind == "single" else 4
    config = typed(f"collector={kind}", f"num_workers={number}", "collector.num_envs=64")
    assert (config.collector.kind, config.num_workers) == (kind, number)
    assert config.collector.num_envs == 64
    assert config.collector.steps_per_batch == 16


def test_rays_address_is_an_option():
    config = typed("collector=ray", "num_workers=2", "ray.address=10.0.0.1:6379")
    assert config.ray.address == "10.0.0.1:6379"


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("nonsense=1", "nonsense: unknown key; allowed: scenario, "),
        ("loss.gama=0.9", "loss.gama: unknown key; did you mean gamma? allowed: gamma, "),
        ("+loss.gama=0.9", "loss.gama: unknown key; did you mean gamma? allowed: gamma, "),
        ("optimizer.lerning_rate=1", "optimizer.lerning_rate: unknown key; did you mean learning_"),
        ("colector.num_envs=4", "colector: unknown key; did you mean collector? allowed: scenario"),
        ("network.depth=3", "network.depth: unknown key; allowed: mu, "),
        ("recipe=wild", "recipe = 'wild': must be fast, interactive, paper"),
        ("collector=cloud", "collector = 'cloud': must be multi, ray, single"),
        ("training_overrides.seed=1", "Could not override 'training_overrides.seed'. To append "),
        ("seed", "Error parsing override 'seed'"),
    ],
)
def test_unknown_keys_and_recipes_are_refused(override, message):
    with pytest.raises(ConfigError) as caught:
        typed(override)
    assert str(caught.value).startswith(message)
    assert len(str(caught.value).splitlines()) == 1


def printed(capsys, *arguments):
    """What the command line prints before it ends the program."""
    with pytest.raises(SystemExit) as caught:
        read_command_line(TrainingConfig, FOLDER, "It learns.", arguments)
    assert caught.value.code == 0
    return capsys.readouterr().out


def test_the_composed_fields_can_be_printed(capsys):
    out = printed(capsys, "seed=7", "--cfg", "job", "recipe=paper")
    assert yaml.safe_load(out) == resolve("seed=7", "recipe=paper")


def test_help_describes_every_field(capsys):
    out = printed(capsys, "--help")
    assert "It learns." in out
    for line in ("seed: ", "loss.gamma: discount factor", "optimizer.mu_learning_rate: "):
        assert f"  {line}" in out


def test_a_file_is_chosen_if_no_override_names_one():
    choices = {"collector": lambda fields: "multi" if fields["seed"] == 5 else "ray"}
    found = [
        compose_fields(TrainingConfig, FOLDER, overrides, choices)["collector"]["kind"]
        for overrides in (["seed=5"], ["seed=6"], ["seed=5", "collector=single"])
    ]
    assert found == ["multi", "ray", "single"]


def test_a_command_line_can_be_given_again(monkeypatch):
    options = ["output=my runs/a", "network.hidden_sizes=[3, 4]"]
    wanted = ["python", "agents/naf/train.py", *options]
    assert shlex.split(describe_command("agents/naf/train.py", options)) == wanted
    monkeypatch.setattr(sys, "argv", ["train.py", *options])
    assert shlex.split(describe_command("agents/naf/train.py")) == wanted
