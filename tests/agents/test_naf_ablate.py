"""The ablations in their quick form: trainings, a row for each, the table of the variants."""

import csv
from pathlib import Path

import numpy as np
import pytest
from programs import BUSY, load_program, run_main

from marl_lanes.recipes.naf import read
from marl_lanes.training.failures import TrainingError

FOLDER = Path(__file__).parents[2] / "agents" / "naf"
PLACE = "<!-- ablations -->\n<!-- end of ablations -->\n"
pytestmark = pytest.mark.training


@pytest.fixture(scope="module")
def program():
    """The program as a module, in this process."""
    return load_program(FOLDER / "ablate.py")


@pytest.fixture
def study(program, tmp_path, monkeypatch):
    """A folder in which all variants train on busy roads."""
    (tmp_path / "busy.yaml").write_text(BUSY, encoding="utf-8")
    (tmp_path / "page.md").write_text(PLACE, encoding="utf-8")
    monkeypatch.setattr(program, "QUICK", (*program.QUICK, "scenario=busy.yaml"))
    return tmp_path


def test_its_quick_form(program, study, monkeypatch):
    """One training diverges; the other is reported, and the end is still an error."""

    def carry_out(runs, folder, *, num_processes):
        """In this process; tests/test_studies.py has the processes."""
        assert [run.name for run in runs] == ["base_0", "mu_mlp_0"]
        assert num_processes == 1
        train = load_program(FOLDER.parents[1] / runs[0].program)
        run_main(train, study, *runs[0].arguments, f"output={folder / runs[0].name}")
        raise TrainingError("mu_mlp_0 diverges")

    monkeypatch.setattr(program, "carry_out", carry_out)
    options = ["--quick", "--only", "base", "mu_mlp", "--seeds", "0", "--docs", "page.md"]
    with pytest.raises(SystemExit, match="mu_mlp_0 diverges"):
        run_main(program, study, *options, "--output", "study")
    with (study / "study" / "ablations.csv").open(newline="", encoding="utf-8") as file:
        (row,) = csv.DictReader(file)
    assert (row["variant"], row["seed"]) == ("base", "0")
    assert 0.0 <= float(row["success_rate"]) <= 1.0
    assert float(row["untrained_cost_ratio"]) > 0.9
    table = (study / "study" / "ablations.md").read_text(encoding="utf-8")
    assert table in (study / "page.md").read_text(encoding="utf-8")
    assert table.splitlines()[2].startswith("| **base**: recipe fast")


def test_what_is_trained(program, tmp_path, monkeypatch):
    planned = []

    def interrupt(runs, *_, **__):
        planned.extend(runs)
        return False

    monkeypatch.setattr(program, "carry_out", interrupt)
    out, _ = run_main(program, tmp_path, "--output", "study")
    assert out == "interrupted; the same command goes on\n"
    assert len(planned) == 3 * len(program.VARIANTS)
    first = {run.name: dict(word.split("=") for word in run.arguments) for run in planned}
    for name, variant in program.VARIANTS.items():
        base = "full_m_1" if "recipe=interactive" in variant.base else "base_1"
        changed = first[f"{name}_1"].items() - first[base].items()
        assert changed == {tuple(word.split("=")) for word in variant.changes}, name


def test_the_command_lines_are_those_of_the_training_program(program):
    options = program.parse([])
    for name in program.VARIANTS:
        arguments = program.plan(name, 0, options).arguments
        assert f"recipe={read([*arguments]).recipe}" in arguments, name


@pytest.mark.parametrize(
    ("is_good", "reached"),
    [([1, 1, 1], 0), ([0, 1, 1], 30), ([1, 0, 1], 60), ([1, 1, 0], None)],
)
def test_a_ratio_is_reached_when_no_later_model_is_worse(program, is_good, reached):
    found = program.find_reached(np.array([0.0, 30.0, 60.0]), np.array(is_good, bool))
    assert found == reached


def test_the_spread_of_seeds(program):
    rows = [{"a": value, "b": None} for value in (1.0, 3.0, 2.0)]
    assert program.spread(rows, "a", 10.0, 1) == "20.0 [10.0, 30.0]"
    assert program.spread(rows[:1], "a", 1.0, 0, "k") == "1k"
    assert program.spread([*rows, {"a": None}], "a", 1.0, 0) == "2 [1, 3] (3 of 4)"
    assert program.spread(rows, "b", 1.0, 0, "k") == "never"
