"""The program that recognises adversaries, on a tiny budget."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import torch
from programs import load_program

from marl_lanes import load_scenario
from marl_lanes.cli.policies import make_policy
from marl_lanes.traffic.roles.changer import CHANGER

PROGRAM = Path(__file__).parents[2] / "agents" / "memory" / "recognise.py"
TINY = ["--roads", "12", "--seconds", "40", "--updates", "2"]
pytestmark = pytest.mark.training


@pytest.fixture(scope="module")
def program():
    """The program as a module, in this process."""
    return load_program(PROGRAM)


def test_what_only_the_past_tells_is_learned_from_stacked_observations_alone(program):
    """Adversarial if and only if the first feature has grown since the step before."""
    plain = load_scenario("paper")
    generator = np.random.default_rng(0)
    offsets, scales = zip(*((one.offset, one.scale) for one in CHANGER.seen(plain)), strict=True)
    seen = offsets + generator.normal(size=(3000, 16, 6)) * scales
    labels = np.where(seen[:, 0, 0] > seen[:, 1, 0], 2, generator.integers(0, 2, 3000))
    times = generator.choice([0.0, 0.1], 3000)
    rows = program.Rows(np.arange(3000) % 20, times, labels, seen.reshape(3000, -1).astype("f4"))
    is_test = rows.road >= 15
    torch.manual_seed(0)
    found = {}
    for name in ("1 observation", "4 stacked"):
        chances = program.learn(program.MEMORIES[name], plain, rows, ~is_test, 300)
        assert chances.sum(1) == pytest.approx(np.ones(3000), abs=1e-5)
        found[name] = program.judge(rows, is_test, chances)
    one, stacked = found.values()
    assert one["time"] == [0.0, 0.1]
    assert sum(one["num_rows"]) == is_test.sum()
    for index in (0, 1):
        assert one["auc"][index]["value"] < 0.88
        assert stacked["auc"][index]["low"] > 0.9
        assert stacked["accuracy"][index]["value"] > one["accuracy"][index]["value"]


def test_it_watches_first_engagements_with_one_driver_behind(program):
    plain = load_scenario("hidden")
    names = list(plain.observation.features)
    rows = program.watch(plain, make_policy("cascade-prior", plain, 0), 6, 40.0, 0)
    newest = dict(zip(names, rows.seen.reshape(len(rows.time), 16, -1)[:, 0].T, strict=True))
    assert (newest["phase"] == 2).all()
    assert (newest["target_follower_gap"] < 200.0).all()
    assert set(np.round(rows.time, 3)) == {round(0.1 * step, 3) for step in range(31)}
    assert np.bincount(rows.disposition).shape == (3,)
    # Before a step has passed, its body is in its own lane's centre.
    assert (newest["lateral_deviation"][rows.time == 0.0] > 3.0).all()
    num_rows = [(rows.time == time).sum() for time in np.unique(rows.time)]
    assert sorted(num_rows, reverse=True) == num_rows


def test_it_writes_and_draws_what_each_memory_finds(program, tmp_path, capsys):
    output, figure = tmp_path / "found.json", tmp_path / "found.svg"
    program.main([*TINY, "--output", str(output), "--figure", str(figure)])
    result = json.loads(output.read_text("utf-8"))
    assert (result["scenario"], result["roads"], result["updates"]) == ("hidden", 12, 2)
    assert list(result["memories"]) == list(program.MEMORIES)
    one = result["memories"]["1 observation"]
    assert one["time"][:3] == [0.0, 0.1, 0.2]
    assert sum(one["num_rows"]) == result["num_test_rows"]
    assert figure.read_bytes().startswith(b"<?xml")
    out = capsys.readouterr().out
    assert "GRU over 16" in out.splitlines()[1]
    assert out.splitlines()[2].startswith("0.0 ")


def test_the_area_counts_pairs_and_its_interval_draws_roads(program):
    score = np.array([0.9, 0.4, 0.4, 0.1])
    kinds, roads = np.array([True, False, True, False]), np.array([0, 0, 1, 1])
    found = program.area(score, kinds, roads)
    assert found["value"] == pytest.approx((1.0 + 1.0 + 0.5 + 1.0) / 4)
    assert found["low"] <= found["value"] <= found["high"]
    reverse = program.area(-score, kinds, roads)
    assert reverse["value"] == pytest.approx(1.0 - found["value"])
    assert program.area(score, kinds | True, roads) == dict.fromkeys(("value", "low", "high"))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--scenario", "interactive"], "must have adversarial and other followers"),
        (["--scenario", "nowhere"], "no such scenario"),
        (["--policy", "nowhere.pt"], "nowhere.pt: cannot be read"),
        (["--roads", "3"], "--roads 3: must be at least 4"),
        (["--seconds", "nan"], "--seconds nan: must be at least 1"),
        (["--updates", "0"], "--updates 0: must be at least 1"),
        (["--seed", "-1"], "--seed -1: must be at least 0"),
        (["--figure", "x.xyz"], r"figure x\.xyz: must be a file that ends in"),
    ],
)
def test_what_cannot_be_is_one_clear_error(
    program, tmp_path, capsys, monkeypatch, options, message
):
    monkeypatch.chdir(tmp_path)
    tiny = ["--roads", "4", "--seconds", "20", "--updates", "1"]
    with pytest.raises(SystemExit) as caught:
        program.main([*tiny, *options, "--output", "x.json"])
    assert caught.value.code == 2
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert re.search(rf"^error: .*{message}", said), said
    assert list(tmp_path.iterdir()) == []
