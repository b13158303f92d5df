"""The program that recovers the reward's weights, on a tiny budget."""

import json
import re
from pathlib import Path

import pytest
from programs import load_program

from marl_lanes.evaluation.preferences import WEIGHTS

PROGRAM = Path(__file__).parents[2] / "agents" / "irl" / "recover.py"
TINY = ["--maneuvers", "3", "--candidates", "3", "--rounds", "2", "--samples", "5"]
pytestmark = pytest.mark.training


@pytest.fixture(scope="module")
def program():
    """The program as a module, in this process."""
    return load_program(PROGRAM)


@pytest.mark.parametrize("policy", ["optimum", "quintic"])
def test_it_says_what_it_learned(program, tmp_path, capsys, policy):
    file = tmp_path / "irl.json"
    program.main([*TINY, "--policy", policy, "--output", str(file)])
    found = json.loads(file.read_text("utf-8"))
    assert "learned: {" in capsys.readouterr().out
    assert (found["policy"], found["maneuvers"], found["completion_rate"]) == (policy, 3, 1.0)
    assert found["true"] == pytest.approx(dict(zip(WEIGHTS[1:], (0.25, 0.025), strict=True)))
    if policy == "optimum":
        assert found["cost_ratio"] == pytest.approx(1.0)
        for name, (low, high) in found["cone"].items():
            assert low <= found["true"][name] <= high
    else:
        assert found["cost_ratio"] > 1.05
        assert found["cone"] is None


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--policy", "nobody"], "checkpoint nobody: cannot be read"),
        (["--policy", "lane-keeping"], "must complete a lane change without an abort; none of 3"),
        (["--maneuvers", "0"], "--maneuvers 0: must be at least 1"),
        (["--rounds", "101"], "--rounds 101: must be at least 1, at most 100"),
        (["--seed", "-1"], "--seed -1: must be at least 0"),
        (["--output", "."], "--output '.': must be a file"),
    ],
)
def test_bad_input_is_one_line(program, tmp_path, monkeypatch, capsys, options, message):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as ended:
        program.main([*TINY, "--output", "irl.json", *options])
    assert ended.value.code == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert re.search(message, error)
    assert not list(tmp_path.iterdir())
