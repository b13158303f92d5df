"""The reproduction of the paper in its quick form: trainings, numbers, tables, figures."""

import csv
import json
import shutil
from pathlib import Path

import pytest
from programs import BUSY, load_program, run_main

from marl_lanes import load_scenario

TOUCH = f"{BUSY}completion: {{max_lateral_speed: null, max_yaw_rate: null}}\n"
FOLDER = Path(__file__).parents[2] / "agents" / "naf"
pytestmark = pytest.mark.training


@pytest.fixture(scope="module")
def program():
    """The program as a module, in this process."""
    return load_program(FOLDER / "reproduce.py")


def test_its_quick_form(program, tmp_path, monkeypatch):
    trained = []

    def carry_out(runs, folder, *, num_processes):
        """In this process; tests/test_studies.py has the processes. The second is the first."""
        trained.extend(run.name for run in runs)
        first, second = (folder / run.name for run in runs)
        train = load_program(FOLDER.parents[1] / runs[0].program)
        run_main(train, tmp_path, *runs[0].arguments, f"output={first}")
        shutil.copytree(first, second)
        config = (first / "config.yaml").read_text(encoding="utf-8")
        other = config.replace("gamma: 0.95", "gamma: 0.99")
        (second / "config.yaml").write_text(other, encoding="utf-8")
        return num_processes == 1

    monkeypatch.setattr(program, "carry_out", carry_out)
    monkeypatch.setattr(program, "TIMES", (3.4,))
    (tmp_path / "busy.yaml").write_text(TOUCH, encoding="utf-8")
    document = tmp_path / "page.md"
    places = [f"<!-- {name} -->\n<!-- end of {name} -->\n" for name in program.TABLES]
    document.write_text("".join(places), encoding="utf-8")
    options = ["--quick", "--scenarios", "busy.yaml", "--seeds", "3", "--docs", "page.md"]
    out, _ = run_main(program, tmp_path, *options, "--output", "study")
    study = tmp_path / "study"
    assert trained == ["busy.yaml_3", "busy.yaml_3_gamma"]
    with (study / "results.csv").open(newline="", encoding="utf-8") as file:
        first, other = csv.DictReader(file)
    assert (first["seed"], first["gamma"], other["gamma"]) == ("3", "0.95", "0.99")
    results = json.loads((study / "results.json").read_text(encoding="utf-8"))
    assert set(results) == {"runs", "discounts", "maneuvers"}
    assert "| the paper | here | busy.yaml |" in out
    text = document.read_text(encoding="utf-8")
    assert (study / "results.md").read_text(encoding="utf-8").splitlines()[0] in text
    assert text.count("\n| ---") == len(program.TABLES)
    figures = {path.name for path in (study / "figures").glob("*.svg")}
    titles = ("loss", "returns", "models", "maneuver_busy")
    assert figures == {f"reproduction_{title}.svg" for title in titles}
    # What is left of an interrupted study.
    shutil.rmtree(study / "busy.yaml_3_gamma")
    (study / "busy.yaml_3" / "evaluation.json").unlink()
    run_main(program, tmp_path, *options, "--output", "study", "--report")
    assert len(trained) == 2
    (row,) = json.loads((study / "results.json").read_text(encoding="utf-8"))["runs"]
    assert row["success_rate"] is None
    assert row["model_last"] == pytest.approx(float(first["model_last"]))


def test_what_the_study_trains_and_that_it_can_be_interrupted(program, tmp_path, monkeypatch):
    planned = []

    def interrupt(runs, *_, **__):
        planned.extend(runs)
        return False

    monkeypatch.setattr(program, "carry_out", interrupt)
    out, _ = run_main(program, tmp_path, "--output", "study")
    assert out == "interrupted; the same command goes on\n"
    names = [f"{scenario}_{seed}" for scenario in ("touch", "paper") for seed in range(3)]
    assert [run.name for run in planned] == [*names, "touch_0_gamma"]
    # The paper's numbers are the recipe's, apart from how often the loss is told.
    changed = {word.split("=")[0] for run in planned for word in run.arguments}
    assert changed == {
        "recipe",
        "scenario",
        "seed",
        "num_threads",
        "collector.steps_per_batch",
        "evaluation.record",
        "loss.gamma",
    }


def test_some_trainings_alone(program, tmp_path, monkeypatch, capsys):
    planned = []
    monkeypatch.setattr(program, "carry_out", lambda runs, *_, **__: planned.extend(runs) or True)
    out, _ = run_main(program, tmp_path, "--only", "paper_1", "touch_0_gamma")
    assert out == ""
    assert [run.name for run in planned] == ["paper_1", "touch_0_gamma"]
    with pytest.raises(SystemExit) as end:
        program.main(["--only", "touch_3"])
    assert end.value.code == 2
    assert "--only 'touch_3': must be among touch_0, touch_1" in capsys.readouterr().err


def test_a_report_of_nothing_is_refused(program, tmp_path, capsys):
    with pytest.raises(SystemExit) as end:
        program.main(["--output", str(tmp_path / "study"), "--report"])
    assert end.value.code == 2
    assert "study': must have a training with two saved models" in capsys.readouterr().err
    assert not (tmp_path / "study").exists()


def test_a_document_without_places_is_refused_before_any_training(program, tmp_path):
    (tmp_path / "page.md").write_text("nothing", encoding="utf-8")
    with pytest.raises(SystemExit) as end:
        run_main(program, tmp_path, "--docs", "page.md", "--output", "study")
    assert end.value.code == 2
    assert not (tmp_path / "study").exists()


def test_with_the_papers_gamma_a_change_saves_little(program):
    """Never changing costs 2 at 0.95; a slow change, and an eager one at 0.99, less."""
    rows = {row["gamma"]: row for row in program.weigh_discounts("touch", load_scenario("touch"))}
    assert rows[0.95]["cost of never changing"] == pytest.approx(2.0)
    assert 0.0 < rows[0.95]["saved by changing [%]"] < 6.0
    assert rows[0.99]["saved by changing [%]"] > 60.0
    assert rows[0.95]["its steps"] > 1.5 * rows[0.99]["its steps"]
