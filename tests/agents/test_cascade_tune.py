"""The search for the cascade's constants, on a tiny budget."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = Path(__file__).parents[2] / "agents" / "cascade" / "tune.py"
TINY = ["--generations", "2", "--population", "6", "--roads", "2", "--seconds", "40"]
NAMES = ["limit", "time", "lateral_limit", "lag", "damping", "threshold"]


def run(*options, folder):
    command = [sys.executable, str(PROGRAM), *options]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=300)


def test_it_finds_constants_no_dearer_than_the_present_ones(tmp_path):
    results = []
    for name in ("one.json", "again.json"):
        done = run(*TINY, "--output", name, folder=tmp_path)
        assert done.returncode == 0, done.stderr
        results.append(json.loads((tmp_path / name).read_text("utf-8")))
    result = results[0]
    assert results[1] == result, "the same seed finds the same"
    assert list(result["constants"]) == NAMES
    assert 0.0 < result["cost"] <= result["cost_of_the_present_constants"] < 6.0
    assert (result["scenario"], result["generations"], result["population"]) == ("paper", 2, 6)


@pytest.mark.parametrize(
    ("options", "message", "status"),
    [
        (["--scenario", "interactive"], "interactive.*must have one action", 1),
        (["--scenario", "nowhere"], "no such scenario", 1),
        (["--roads", "0"], "--roads 0: must be at least 1", 2),
        (["--seconds", "inf"], "--seconds inf: must be above 0 and finite", 2),
        (["--seconds", "0.5"], "seconds = 0.5: must be longer; no command .* ended on 2 roads", 1),
        (["--seed", "-1"], "--seed -1: must be at least 0", 2),
    ],
)
def test_what_cannot_be_is_one_clear_error(tmp_path, options, message, status):
    done = run(*TINY, *options, "--output", "x.json", folder=tmp_path)
    assert done.returncode == status
    last = done.stderr.strip().splitlines()[-1]
    assert re.search(message, last), done.stderr
    assert list(tmp_path.iterdir()) == []
