"""The command line: what it prints, what it writes, and how it fails."""

import json
import sys

import pytest
import torch
import yaml

from marl_lanes import cli, list_scenarios, load_scenario
from marl_lanes.cli import main
from marl_lanes.traffic.roles.follower import FOLLOWER
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


@pytest.mark.slow
def test_an_evaluation_is_printed_and_written(capsys, tmp_path):
    file = tmp_path / "deep" / "result.json"
    assert main([*EVALUATE, "--seed", "5", "--scenario", "touch", "--json", str(file)]) == 0
    captured = capsys.readouterr()
    result = json.loads(file.read_text(encoding="utf-8"))
    assert captured.err == ""
    printed = dict(line.split(maxsplit=1) for line in captured.out.splitlines())
    assert set(printed) == set(result)
    assert list(result)[:3] == ["scenario", "policy", "seed"]
    assert [result[key] for key in list(result)[:4]] == ["touch", "damped-prior", 5, 4]
    for key, value in result.items():
        if isinstance(value, float):
            assert float(printed[key]) == pytest.approx(value, rel=1e-4)
    assert result["completion_rate"] > 0.0
    assert [path.name for path in file.parent.iterdir()] == ["result.json"]


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
        (["evaluate", "--policy", "lane-keeping", "--scenario", "blind.yaml"], "must contain"),
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
        ["crossplay", "--changers", "random"],
        ["crossplay", "--followers", "neutral"],
        ["followers"],
        ["followers", "--figure", "x.png", "--policy", "perfect"],
    ],
)
def test_bad_arguments_end_with_2(capsys, arguments):
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "usage: marl-lanes" in captured.err


@pytest.mark.parametrize("command", ["evaluate", "crossplay", "followers"])
def test_help_ends_with_0(capsys, command):
    with pytest.raises(SystemExit) as caught:
        main([command, "--help"])
    assert caught.value.code == 0
    shown = capsys.readouterr().out
    assert "--maneuvers" in shown
    assert "--import MODULE" in shown


QUICK = "{num_agents: 4, departures: {interval: [2.0, 4.0]}, max_vehicles: 128}"
CROSSPLAY = ["crossplay", "--maneuvers", "8", "--changers"]
FOLLOWERS = ["followers", "--maneuvers", "12", "--seed", "1"]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Two runs' changers, a follower's checkpoint and two quick scenarios."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "quick.yaml").write_text(QUICK, encoding="utf-8")
    weak = "{action: {max_yaw_acceleration: 0.25}, " + QUICK[1:]
    (tmp_path / "weak.yaml").write_text(weak, encoding="utf-8")
    (tmp_path / "text.pt").write_text("hello\n", encoding="utf-8")
    torch.manual_seed(0)
    network = make_network(load_scenario("paper"), "damped")
    for name in ("runs/a/checkpoints/final.pt", "runs/a/checkpoints/step_7.pt", "b.pt"):
        save_checkpoint(tmp_path / name, network, "paper", 0)
    save_checkpoint(tmp_path / "weak.pt", make_network(load_scenario("weak.yaml"), "mlp"), "w", 0)
    driver = make_network(load_scenario("quick.yaml"), "mlp", role=FOLLOWER)
    for name in ("runs/rude/checkpoints/final.pt", "runs/kind/checkpoints/final.pt"):
        save_checkpoint(tmp_path / name, driver, "quick", 0)
    return tmp_path


def files(folder):
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.slow
def test_a_crossplay_is_printed_written_and_drawn(capsys, folder):
    before = files(folder)
    rude = "learned:runs/rude/checkpoints/final.pt"
    arguments = [*CROSSPLAY, "runs/a/checkpoints/final.pt", "lane-keeping", "--seed", "3"]
    followers = ["--followers", "cooperative", "adversarial", rude]
    outputs = ["--json", "out/table.json", "--figure", "out/table.png"]
    assert main([*arguments, *followers, "--scenario", "quick.yaml", *outputs]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    assert files(folder) - before == {"out/table.json", "out/table.png"}
    result = json.loads((folder / "out/table.json").read_text(encoding="utf-8"))
    assert result["changers"] == {"a": "quick", "lane-keeping": "quick"}
    assert result["policies"] == {"a": arguments[4], "lane-keeping": "lane-keeping"}
    assert list(result["followers"]) == ["cooperative", "adversarial", "learned:rude"]
    assert result["followers"]["learned:rude"] == {
        "mix": {"learned": 1.0},
        "learned": {"checkpoint": "runs/rude/checkpoints/final.pt"},
    }
    assert (result["seed"], result["num_maneuvers"], len(result["pairs"])) == (3, 8, 6)
    assert max(map(len, captured.out.splitlines())) <= 120
    first = result["pairs"][0]["statistics"]["completion_rate"]
    printed = f"{100 * first['value']:.1f} [{100 * first['low']:.1f}, {100 * first['high']:.1f}]"
    (row,) = [line for line in captured.out.splitlines() if line.startswith("completed")]
    assert row.split("  ")[-3].strip() == printed or printed in row
    assert "learned:rude" in captured.out


def test_a_pair_is_what_evaluate_prints(capsys, folder):
    arguments = ["--scenario", "quick.yaml", "--json"]
    policy = "runs/a/checkpoints/final.pt"
    assert main([*CROSSPLAY, policy, "--followers", "neutral", *arguments, "pair.json"]) == 0
    assert main(["evaluate", policy, "--maneuvers", "8", *arguments, "one.json"]) == 0
    capsys.readouterr()
    pair = json.loads((folder / "pair.json").read_text(encoding="utf-8"))["pairs"][0]
    one = json.loads((folder / "one.json").read_text(encoding="utf-8"))
    for key, found in pair["statistics"].items():
        assert found["value"] == one[key], key


@pytest.mark.slow
def test_a_changer_may_bring_its_scenario(capsys, folder):
    entries = ["weak.pt@weak.yaml", "b.pt", "b.pt@paper"]
    followers = ["--followers", "neutral", "--scenario", "quick.yaml", "--json", "table.json"]
    assert main([*CROSSPLAY, *entries, *followers]) == 0
    capsys.readouterr()
    result = json.loads((folder / "table.json").read_text(encoding="utf-8"))
    assert result["changers"] == {"weak@weak": "weak", "b": "quick", "b@paper": "paper"}
    assert [pair["scenario"] for pair in result["pairs"]] == ["weak", "quick", "paper"]


@pytest.mark.parametrize(
    ("entries", "labels"),
    [
        (["runs/a/checkpoints/final.pt", "runs/b/checkpoints/final.pt"], ["a", "b"]),
        (["x/runs/a/checkpoints/final.pt", "y/runs/a/checkpoints/final.pt", "c.pt"],
         ["x/runs/a", "y/runs/a", "c"]),
        (["runs/a/checkpoints/step_1.pt", "runs/a/checkpoints/step_2.pt"],
         ["a/step_1", "a/step_2"]),
        (["runs/a/checkpoints/final.pt", "runs/a/checkpoints/step_2.pt"], ["a", "a/step_2"]),
        (["one/policy.pt", "two/policy.pt"], ["one/policy", "two/policy"]),
        (["/r/one/policy.pt", "policy.pt"], ["one/policy", "policy"]),
        (["random", "x/random.pt"], ["random", "x/random"]),
        (["p.pt", "p.pt@settled", "p.pt@my/settled.yaml"],
         ["p", "p.pt@settled", "p.pt@my/settled.yaml"]),
    ],
)  # fmt: skip
def test_every_changer_has_a_name_of_its_own(entries, labels):
    found = cli._label_changers(entries)
    assert len(found) == len(entries)
    assert list(found) == labels


def test_a_module_of_ones_own_registers_followers(capsys, folder):
    text = (
        "import numpy as np\n"
        "from marl_lanes import register_follower\n"
        "register_follower('brakes', lambda seen: np.full(len(seen), -3.0))\n"
    )
    (folder / "my_followers.py").write_text(text, encoding="utf-8")
    arguments = [*CROSSPLAY, "damped-prior", "--followers", "neutral", "brakes"]
    arguments += ["--scenario", "quick.yaml", "--json", "table.json"]
    before = list(sys.path)
    try:
        assert main(arguments) == 2
        assert "brakes" in capsys.readouterr().err
        assert main([*arguments, "--import", "my_followers"]) == 0
    finally:
        sys.modules.pop("my_followers", None)
    assert sys.path == before
    pairs = json.loads((folder / "table.json").read_text(encoding="utf-8"))["pairs"]
    braking = [pair["statistics"]["mean_max_follower_braking_all"]["value"] for pair in pairs]
    assert braking[1] > 2.5
    assert braking[1] != braking[0]


@pytest.mark.slow
def test_the_gap_under_every_follower_is_printed_written_and_drawn(capsys, folder):
    before = files(folder)
    outputs = ["--json", "gaps.json", "--figure", "gaps.png", "--scenario", "quick.yaml"]
    assert main([*FOLLOWERS, *outputs]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    assert files(folder) - before == {"gaps.json", "gaps.png"}
    result = json.loads((folder / "gaps.json").read_text(encoding="utf-8"))
    assert list(result["followers"]) == ["cooperative", "neutral", "adversarial"]
    assert (result["policy"], result["seed"]) == ("tuned-cascade", 1)
    rows = [line.split()[0] for line in captured.out.splitlines() if line]
    assert rows[-3:] == ["cooperative", "neutral", "adversarial"]
    assert f"maneuver {result['maneuver']}" in captured.out
    wanted = ["--maneuver", str(result["maneuver"]), "--followers", "neutral", "adversarial"]
    assert main([*FOLLOWERS, *outputs, *wanted, "--policy", "tuned-cascade"]) == 0
    again = json.loads((folder / "gaps.json").read_text(encoding="utf-8"))
    assert again["followers"]["neutral"]["shown"] == result["followers"]["neutral"]["shown"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([*CROSSPLAY, "absent.pt", "--followers", "neutral"], "checkpoint absent.pt"),
        ([*CROSSPLAY, "weak.pt", "--followers", "neutral"], "checkpoint weak.pt: its action bound"),
        ([*CROSSPLAY, "b.pt", "--followers", "neutral", "learned:absent.pt"], "absent.pt"),
        ([*CROSSPLAY, "b.pt", "--followers", "neutral", "learned:b.pt"], "b.pt"),
        ([*CROSSPLAY, "b.pt", "--followers", "neutral", "unheard_of"], "unheard_of"),
        ([*CROSSPLAY, "b.pt", "--followers", "a:b"], "--followers a:b: must be a name, or"),
        ([*CROSSPLAY, "b.pt", "--followers", "learned:"], "--followers learned:: must be"),
        ([*CROSSPLAY, "b.pt", "b.pt", "--followers", "neutral"], "--changers b.pt: must be given"),
        ([*CROSSPLAY, "b.pt", "--followers", "x", "x"], "--followers x: must be given once"),
        ([*CROSSPLAY, "b.pt@", "--followers", "neutral"], "--changers b.pt@: must be CHANGER"),
        ([*CROSSPLAY, "b.pt@papier", "--followers", "neutral"], "'papier': no such scenario"),
        (
            [*CROSSPLAY, "b.pt", "--followers", "neutral", "--figure", "x.xyz"],
            "must be a file that",
        ),
        ([*CROSSPLAY, "b.pt", "--followers", "neutral", "--json", "."], "--json .: must be a file"),
        ([*CROSSPLAY, "b.pt", "--followers", "neutral", "--import", "absent"], "--import absent"),
        ([*CROSSPLAY, "b.pt", "--followers", "neutral", "--import", "../x"], "must be the dotted"),
        (
            [*CROSSPLAY[:2], "0", "--changers", "b.pt", "--followers", "neutral"],
            "num_maneuvers = 0",
        ),
        ([*FOLLOWERS, "absent.pt", "--figure", "x.png"], "checkpoint absent.pt"),
        ([*FOLLOWERS, "--figure", "x.png", "--maneuver", "12"], "maneuver = 12: must be 0 to 11"),
        ([*FOLLOWERS, "--figure", "."], "must be a file that ends in"),
    ],
)
def test_bad_comparisons_are_one_line_and_nothing_is_driven(
    capsys, folder, monkeypatch, arguments, message
):
    def drive(*_, **__):
        raise AssertionError("driven, though the arguments are wrong")

    monkeypatch.setattr("marl_lanes.evaluation.crossplay.run_maneuvers", drive)
    before = files(folder)
    assert main(arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("error: ")
    assert message in captured.err
    assert len(captured.err.splitlines()) == 1
    assert files(folder) == before


def test_a_figure_needs_matplotlib(capsys, folder, monkeypatch):
    monkeypatch.setattr(cli, "find_spec", lambda _: None)
    assert main([*FOLLOWERS, "--figure", str(folder / "x.png")]) == 2
    assert "pip install 'marl-lanes[train]'" in capsys.readouterr().err


def test_progress_is_shown_on_a_terminal_alone(capsys, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    show = cli._Progress("driving", 400)
    for count in range(401):
        show(count)
    show.close()
    shown = capsys.readouterr().err
    assert shown.count("\r") == 103
    assert "\rdriving  50 %" in shown
    assert shown.endswith(" " * 20 + "\r")
