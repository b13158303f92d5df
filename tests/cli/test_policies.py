"""The policy of a name or a checkpoint."""

import numpy as np
import pytest
import torch
from cli.commands import EVALUATE

from marl_lanes import load_scenario
from marl_lanes.cli.main import main
from marl_lanes.cli.policies import UNTRAINED, make_policy
from marl_lanes.training.checkpoint import make_network, save_checkpoint


def test_every_name_is_a_policy_of_its_own():
    scenario = load_scenario("paper")
    observations = np.random.default_rng(0).normal(0.0, 0.1, (16, 6)).astype(np.float32)
    actions = {name: make_policy(name, scenario, 3)(observations) for name in UNTRAINED}
    for name, found in actions.items():
        assert [other for other in UNTRAINED if np.array_equal(actions[other], found)] == [name]
    assert np.array_equal(make_policy("random", scenario, 3)(observations), actions["random"])
    assert not np.array_equal(make_policy("random", scenario, 4)(observations), actions["random"])


@pytest.mark.slow
@pytest.mark.parametrize("policy", ["lane-keeping", "random"])
def test_policies_without_learning(capsys, policy):
    arguments = ["evaluate", "--policy", policy, "--maneuvers", "2"]
    outputs = []
    for _ in range(2):
        assert main(arguments) == 0
        outputs.append(capsys.readouterr().out)
    assert outputs[0] == outputs[1]
    rate = dict(line.split(maxsplit=1) for line in outputs[0].splitlines())["completion_rate"]
    assert float(rate) == 0.0 or policy == "random"


@pytest.mark.slow
def test_a_checkpoint_is_evaluated(capsys, tmp_path):
    """The damped prior from a file: the same numbers as by its name."""
    torch.manual_seed(0)
    file = tmp_path / "policy.pt"
    save_checkpoint(file, make_network(load_scenario("paper"), "damped"), "paper", 0)
    assert main(["evaluate", str(file), "--maneuvers", "4"]) == 0
    first = capsys.readouterr().out.splitlines()
    assert main(EVALUATE) == 0
    second = capsys.readouterr().out.splitlines()
    assert first[1].split() == ["policy", str(file)]
    assert [first[0], *first[2:]] == [second[0], *second[2:]]
