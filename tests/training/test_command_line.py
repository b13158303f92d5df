"""The command line: overrides, choices of files, and what is refused."""

import re
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
    refusing,
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
        ("training_overrides.seed=1", "training_overrides.seed: unknown key; allowed: name, "),
        ("+seed=1", "Could not append to config. An item is already at 'seed'. "),
        ("++recipe=paper", "force-add of config groups is not supported: '++recipe=paper'"),
        ("loss=[]", "loss=[]: must be of the kind that --cfg job shows"),
        ("network.hidden_sizes={a:3}", "network.hidden_sizes={a:3}: must be of the kind that "),
        ("seed=${seed}", "Recursive interpolation detected "),
    ],
)
def test_what_hydra_refuses_is_one_line(override, message):
    with pytest.raises(ConfigError) as caught:
        typed(override)
    assert str(caught.value).startswith(message)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize("option", ["--config-dir=/tmp", "--multirun", "--cf job", "-x", "--cfg=x"])
def test_options_are_refused_in_one_line(capsys, option):
    with pytest.raises(SystemExit) as caught:
        read_command_line(TrainingConfig, FOLDER, "It learns.", ["seed=1", *option.split()])
    assert caught.value.code == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert re.fullmatch(r"error: .*; --help shows what is allowed\n", err)
    assert option.split()[0].partition("=")[0] in err


@pytest.mark.parametrize("kind", [ValueError, ConfigError, FileNotFoundError])
def test_bad_input_ends_with_2_and_one_line(capsys, kind):
    with pytest.raises(SystemExit) as caught, refusing():
        raise kind("it is\nnot there")
    assert caught.value.code == 2
    assert capsys.readouterr() == ("", "error: it is not there\n")


def test_a_fault_of_the_program_is_none_of_the_input():
    with pytest.raises(KeyError), refusing():
        raise KeyError("x")


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
    assert shlex.split(describe_command("python agents/naf/train.py", options)) == wanted
    monkeypatch.setattr(sys, "argv", ["train.py", *options])
    assert shlex.split(describe_command("python agents/naf/train.py")) == wanted
