"""The search for the cascade's constants, on a tiny budget."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from programs import load_program

PROGRAM = Path(__file__).parents[2] / "agents" / "cascade" / "tune.py"
TINY = ["--generations", "2", "--population", "6", "--roads", "2", "--seconds", "40"]
NAMES = ["limit", "time", "lateral_limit", "lag", "damping", "threshold"]
pytestmark = pytest.mark.training


@pytest.fixture(scope="module")
def program():
    """The program as a module, in this process."""
    return load_program(PROGRAM)


@pytest.fixture
def run(program, tmp_path, monkeypatch):
    """Runs the program in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def run_with(*options):
        monkeypatch.setattr(sys, "argv", [PROGRAM.name, *TINY, *options])
        program.main()

    return run_with


def test_it_finds_constants_no_dearer_than_the_present_ones(run, tmp_path):
    run("--output", "here.json")
    command = [sys.executable, str(PROGRAM), *TINY, "--output", "process.json"]
    subprocess.run(command, cwd=tmp_path, check=True, timeout=300)
    results = [
        json.loads((tmp_path / name).read_text("utf-8")) for name in ("here.json", "process.json")
    ]
    result = results[0]
    assert results[1] == result, "the same seed finds the same"
    assert list(result["constants"]) == NAMES
    assert 0.0 < result["cost"] <= result["cost_of_the_present_constants"] < 6.0
    assert (result["scenario"], result["generations"], result["population"]) == ("paper", 2, 6)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--scenario", "interactive"], "interactive.*must have one action"),
        (["--scenario", "nowhere"], "no such scenario"),
        (["--roads", "0"], "--roads 0: must be at least 1"),
        (["--seconds", "inf"], "--seconds inf: must be above 0 and at most 86400"),
        (["--seconds", "0.5"], "seconds = 0.5: must be longer; no command .* ended on 2 roads"),
        (["--seed", "-1"], "--seed -1: must be at least 0"),
    ],
)
def test_what_cannot_be_is_one_clear_error(run, tmp_path, capsys, options, message):
    with pytest.raises(SystemExit) as caught:
        run(*options, "--output", "x.json")
    assert caught.value.code == 2
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert re.search(rf"^error: .*{message}", said), said
    assert list(tmp_path.iterdir()) == []
