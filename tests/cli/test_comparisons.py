"""The commands that drive: what they print, what they write, and how they fail."""

import json

import pytest
from cli.commands import CROSSPLAY, EVALUATE, FOLLOWERS, assert_refused, files

from marl_lanes import load_scenario
from marl_lanes.cli.main import main
from marl_lanes.training.checkpoint import make_network, save_checkpoint


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


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([*EVALUATE, "--scenario", "papier"], "scenario 'papier': no such scenario"),
        ([*EVALUATE[:-1], "0"], "--maneuvers: '0': must be a whole number, 1 to"),
        ([*EVALUATE, "--seed", "-1"], "--seed: '-1': must be a whole number, 0 to"),
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
    assert_refused(capsys, tmp_path, [*arguments, "--json", "result.json"], message)


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


@pytest.mark.slow
def test_the_gap_under_every_follower_is_printed_written_and_drawn(capsys, folder):
    before = files(folder)
    drawn = ["--figure", "gaps.png", "--figure", "gaps.svg"]
    outputs = ["--json", "gaps.json", *drawn, "--scenario", "quick.yaml"]
    assert main([*FOLLOWERS, *outputs]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    assert files(folder) - before == {"gaps.json", "gaps.png", "gaps.svg"}
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
            "--maneuvers: '0'",
        ),
        ([*FOLLOWERS, "absent.pt", "--figure", "x.png"], "checkpoint absent.pt"),
        ([*FOLLOWERS, "--figure", "x.png", "--maneuver", "12"], "maneuver = 12: must be 0 to 11"),
        ([*FOLLOWERS, "--figure", "."], "--figure .: must be a file, not a folder"),
    ],
)
def test_bad_comparisons_are_one_line_and_nothing_is_driven(
    capsys, folder, monkeypatch, arguments, message
):
    def drive(*_, **__):
        raise AssertionError("driven, though the arguments are wrong")

    monkeypatch.setattr("marl_lanes.evaluation.crossplay.run_maneuvers", drive)
    assert_refused(capsys, folder, arguments, message)
