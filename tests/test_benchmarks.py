"""Benchmarks that train or render run to their end; their figures need an idle machine."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"


@pytest.mark.training
def test_a_policy_step_and_the_split_of_a_training(tmp_path):
    file = tmp_path / "figures.json"
    program = [sys.executable, str(BENCHMARKS / "policy_step.py")]
    options = ["--rounds", "1", "--transitions", "500", "--json", str(file)]
    done = subprocess.run([*program, *options], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    figures = json.loads(file.read_text(encoding="utf-8"))
    assert [row["slots"] for row in figures["slots"]] == [4, 16, 64]
    assert set(figures["split"]) == {"fast", "paper", "interactive"}
    for split in figures["split"].values():
        microseconds, share = split["simulate"]
        assert microseconds > 0.0
        assert 0.0 < share < 1.0


@pytest.mark.training
def test_the_pictures_of_a_second(tmp_path):
    file = tmp_path / "figures.json"
    program = [sys.executable, str(BENCHMARKS / "rendering.py")]
    options = ["--rounds", "1", "--json", str(file)]
    done = subprocess.run([*program, *options], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    figures = json.loads(file.read_text(encoding="utf-8"))
    for size in ("1280x720", "600x180"):
        row = figures[f"parallel_env {size}"]
        assert 1.0 < row["with_steps"] < row["alone"]
        assert f"{size} " in done.stdout
