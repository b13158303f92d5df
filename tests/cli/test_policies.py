"""The policy of a name, a checkpoint or a function of the user."""

import sys

import numpy as np
import pytest
import torch
from checkpoints import save_trained
from cli.commands import EVALUATE
from report.runs import make_run

from marl_lanes import load_scenario
from marl_lanes.cli.main import main
from marl_lanes.cli.policies import UNTRAINED, find_training, is_policy, make_policy
from marl_lanes.traffic.machine.state import Phase
from marl_lanes.training.checkpoint import make_network, save_checkpoint


def test_every_name_is_a_policy_of_its_own():
    scenario = load_scenario("interactive")
    features = list(scenario.observation.features)
    observations = np.random.default_rng(0).normal(0.0, 0.01, (16, len(features)))
    for name, value in (("speed", 22.0), ("lateral_deviation", 3.75)):
        observations[:, features.index(name)] += value
    observations[:, features.index("phase")] = Phase.ENGAGED
    observations = observations.astype(np.float32)
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


def test_a_policy_of_the_zoo_is_that_of_its_file(small_zoo):
    scenario = load_scenario("paper")
    observations = np.random.default_rng(0).normal(0.0, 0.1, (16, 6)).astype(np.float32)
    actions = make_policy("zoo:paper", scenario, 0)(observations)
    assert np.array_equal(
        make_policy(str(small_zoo / "paper.pt"), scenario, 0)(observations), actions
    )
    with pytest.raises(ValueError, match=r"zoo:absent: no such policy in the zoo; allowed: zoo:p"):
        make_policy("zoo:absent", scenario, 0)
    with pytest.raises(ValueError, match=r"zoo:adversary: its features are"):
        make_policy("zoo:adversary", scenario, 0)


def test_a_function_of_the_user_is_a_policy_unless_a_file_has_its_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = "make = lambda scenario: lambda seen: seen[:, :1]\n"
    (tmp_path / "own_policy.py").write_text(text, encoding="utf-8")
    seen = np.full((2, 6), 7.0, np.float32)
    scenario = load_scenario("paper")
    assert make_policy("own_policy:make", scenario, 0)(seen).tolist() == [[7.0], [7.0]]
    sys.modules.pop("own_policy")
    save_trained(tmp_path / "own_policy:make")
    assert make_policy("own_policy:make", scenario, 0)(seen)[0, 0] != 7.0
    assert "own_policy" not in sys.modules


def test_what_a_policy_is(small_zoo):
    names = [*UNTRAINED, "zoo:any", "module:function", str(small_zoo / "paper.pt")]
    assert all(map(is_policy, names))
    assert not any(map(is_policy, ["absent.pt", "Random", "a/b:c"]))


def test_what_a_policy_has_learned_from(small_zoo):
    assert find_training("tuned-cascade") is None
    assert find_training("module:function") is None
    of_zoo = find_training("zoo:paper")
    assert (of_zoo.transitions, of_zoo.seconds) == (1234, 1.5)
    alone = find_training(str(small_zoo / "paper.pt"))
    assert (alone.scenario, alone.transitions) == ("paper", 1234)
    assert alone.seconds is None
    assert alone.command is None


def test_of_a_run_all_transitions_count_and_demonstrations_apart(tmp_path):
    run = make_run(tmp_path / "run")
    # The final model is an earlier one.
    file = save_trained(run / "checkpoints" / "final.pt")
    (run / "evaluations.csv").write_text("transitions\n0\n1234\n4567\n", encoding="utf-8")
    (run / "config.yaml").write_text("demonstrations: {num_transitions: 89}\n", encoding="utf-8")
    found = find_training(str(file))
    assert (found.scenario, found.transitions, found.demonstrations) == ("paper", 4567, 89)
    assert (found.seconds, found.command) == (1156.25, "python train.py seed=0")
