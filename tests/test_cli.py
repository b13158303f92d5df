"""The command line: what it prints, what it writes, and how it fails."""

import json

import pytest
import torch
import yaml

from marl_lanes import list_scenarios, load_scenario
from marl_lanes.cli import main
from marl_lanes.training.checkpoint import make_network, save_checkpoint

torch.set_num_threads(1)
EVALUATE = ["evaluate", "--policy", "damped-prior", "--maneuvers", "4"]


def test_every_scenario_is_listed(capsys):
    assert main(["scenarios"]) == 0
    captured = capsys.readouterr()
    rows = captured.out.splitlines()
    assert [row.split()[0] for row in rows] == list_scenarios()
    for row, name in zip(rows, list_scenarios(), strict=True):
        assert row.endswith(load_scenario(name).description)
    assert captured.err == ""


@pytest.mark.parametrize("name", list_scenarios())
def test_a_printed_scenario_is_the_scenario(capsys, tmp_path, name):
    assert main(["scenarios", name]) == 0
    text = capsys.readouterr().out
    assert load_scenario(yaml.safe_load(text)) == load_scenario(name)
    file = tmp_path / "printed.yaml"
    file.write_text(text, encoding="utf-8")
    assert load_scenario(file) == load_scenario(name)
    assert main(["scenarios", str(file)]) == 0
    assert capsys.readouterr().out == text


def test_an_evaluation_is_printed_and_written(capsys, tmp_path):
    file = tmp_path / "deep" / "result.json"
    assert main([*EVALUATE, "--seed", "5", "--scenario", "settled", "--json", str(file)]) == 0
    captured = capsys.readouterr()
    result = json.loads(file.read_text(encoding="utf-8"))
    assert captured.err == ""
    printed = dict(line.split(maxsplit=1) for line in captured.out.splitlines())
    assert set(printed) == set(result)
    assert list(result)[:3] == ["scenario", "policy", "seed"]
    assert [result[key] for key in list(result)[:4]] == ["settled", "damped-prior", 5, 4]
    for key, value in result.items():
        if isinstance(value, float):
            assert float(printed[key]) == pytest.approx(value, rel=1e-4)
    assert result["completion_rate"] > 0.0
    assert [path.name for path in file.parent.iterdir()] == ["result.json"]


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


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["scenarios", "papier"], "scenario 'papier': no such scenario"),
        (["scenarios", "absent.yaml"], "absent.yaml"),
        ([*EVALUATE, "--scenario", "papier"], "scenario 'papier': no such scenario"),
        ([*EVALUATE[:-1], "0"], "num_maneuvers = 0: must be at least 1"),
        ([*EVALUATE, "--seed", "-1"], "seed = -1"),
        (["evaluate", "absent.pt"], "checkpoint absent.pt: cannot be read"),
        (["evaluate", "."], "checkpoint ."),
        (["evaluate", "wrong.pt"], "checkpoint wrong.pt: its features"),
        (["evaluate", "text.pt"], "checkpoint text.pt: not a checkpoint"),
        ([*EVALUATE, "--scenario", "endless.yaml"], "needs num_agents"),
        (["evaluate", "--policy", "lane-keeping", "--scenario", "blind.yaml"], "must hold"),
        ([*EVALUATE, "--scenario", "blind.yaml"], "needs the feature"),
    ],
)
def test_bad_input_is_one_line_and_nothing_is_written(
    capsys, tmp_path, monkeypatch, arguments, message
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "endless.yaml").write_text("num_agents: null\n", encoding="utf-8")
    blind = "observation: {features: [speed, curvature]}\n"
    (tmp_path / "blind.yaml").write_text(blind, encoding="utf-8")
    (tmp_path / "text.pt").write_text("hello\n", encoding="utf-8")
    other = load_scenario("blind.yaml")
    save_checkpoint(tmp_path / "wrong.pt", make_network(other, "mlp"), "blind", 0)
    before = set(tmp_path.iterdir())
    extra = ["--json", "result.json"] if arguments[0] == "evaluate" else []
    assert main([*arguments, *extra]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("error: ")
    assert message in captured.err
    assert len(captured.err.splitlines()) == 1
    assert set(tmp_path.iterdir()) == before


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["train"],
        ["evaluate"],
        ["evaluate", "--policy", "perfect"],
        ["evaluate", "policy.pt", "--policy", "random"],
        [*EVALUATE, "--maneuvers", "many"],
    ],
)
def test_bad_arguments_end_with_2(capsys, arguments):
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "usage: marl-lanes" in captured.err


def test_help_ends_with_0(capsys):
    with pytest.raises(SystemExit) as caught:
        main(["evaluate", "--help"])
    assert caught.value.code == 0
    assert "--maneuvers" in capsys.readouterr().out
