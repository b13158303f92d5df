"""What the paper says of its training, measured in the files of a run."""

import json
from types import SimpleNamespace

import pytest
import yaml

from marl_lanes.report import statements
from marl_lanes.report.statements import STATEMENTS, measure_run, tabulate_statements

CONFIG = {
    "scenario": "touch",
    "seed": 7,
    "loss": {"gamma": 0.95},
    "optimizer": {"pretraining_transitions": 50},
}
FINAL = {
    "success_rate": 0.5,
    "completion_rate": 1.0,
    "cost_ratio": 1.5,
    "mean_return": -3.0,
    "mean_num_steps": 30.0,
}
MODEL = {"success_rate": 0.25, "completion_rate": 0.75, "mean_peak_yaw_rate": 0.5}


@pytest.fixture
def run(tmp_path, monkeypatch):
    """100 transitions with a maneuver every two, every fifth of which is not completed."""
    tables = {
        "metrics": [
            "transitions,loss",
            *(f"{at},{1.0 / at if at > 1 else ''}" for at in range(1, 101)),
        ],
        "maneuvers": [
            "transitions,return,outcome",
            *(f"{at},{-at},{3 if at % 10 == 0 else 1}" for at in range(2, 101, 2)),
        ],
        "evaluations": [
            "transitions,checkpoint,success_rate,mean_return",
            "25,step_1.pt,0.5,-4",
            "50,step_2.pt,0.5,-3",
            "75,step_3.pt,0.5,-3.5",
            "100,step_4.pt,0.5,-2",
            "100,final.pt,0.5,-2",
        ],
    }
    for name, lines in tables.items():
        (tmp_path / f"{name}.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (tmp_path / "config.yaml").write_text(yaml.safe_dump(CONFIG), encoding="utf-8")
    (tmp_path / "evaluation.json").write_text(json.dumps(FINAL), encoding="utf-8")
    (tmp_path / "checkpoints").mkdir()
    for number in (1, 2, 3, 4):
        (tmp_path / "checkpoints" / f"step_{number}.pt").touch()
    peaks = {"first": 2.0, "last": None}

    def evaluate(maneuvers, *_, **__):
        return {**MODEL, "mean_peak_yaw_acceleration": peaks[maneuvers]}

    monkeypatch.setattr(statements, "evaluate", evaluate)
    return measure_run(tmp_path, ("first", "last"), SimpleNamespace())


def test_a_run_that_is_not_over_has_no_final_numbers(run, tmp_path):
    (tmp_path / "evaluation.json").unlink()
    (tmp_path / "checkpoints" / "step_4.pt").unlink()
    found = measure_run(tmp_path, ("first", "last"), SimpleNamespace())
    assert found["model_last"] == -3.5
    changed = {key for key, value in run.items() if found[key] != value}
    assert changed == {*FINAL, "model_last", "model_rises"}
    assert all(found[key] is None for key in FINAL)


def test_the_numbers_of_a_run(run):
    assert (run["scenario"], run["seed"], run["gamma"]) == ("touch", 7, 0.95)
    assert run["transitions"] == 100.0
    # 6,500 in 200,000 are 1.6 in 50 transitions.
    assert (run["maneuvers"], run["maneuvers_wanted"]) == (25, 1.625)
    assert run["steps_a_maneuver"] == 2.0
    assert run["completed_early"] == 0.8
    assert run["loss_first"] == pytest.approx(sum(1.0 / at for at in range(2, 10)) / 8)
    assert run["loss_last"] == pytest.approx(sum(1.0 / at for at in range(90, 101)) / 11)
    assert run["return_first"] == -5.0
    assert run["return_before"] == -85.0
    assert run["return_last"] == -95.0
    assert run["completed_first"] == 1.0
    assert run["completed_last"] == pytest.approx(4 / 6)
    assert (run["model_first"], run["model_last"]) == (-4.0, -2.0)
    assert run["model_rises"] == pytest.approx(2 / 3)
    assert (run["peak_acceleration_first"], run["peak_acceleration_last"]) == (2.0, None)
    assert run["completion_last"] == 0.75
    assert {key: run[key] for key in FINAL} == FINAL


def test_when_a_statement_holds():
    first, loss, rewards, models, curves = (one.holds for one in STATEMENTS)
    assert first({"maneuvers": 5900, "maneuvers_wanted": 6500})
    assert not first({"maneuvers": 4687, "maneuvers_wanted": 6500})
    assert loss({"loss_first": 1.0, "loss_last": 0.4})
    assert not loss({"loss_first": 1.0, "loss_last": 0.6})
    steady = {"return_first": -4.0, "return_before": -3.1, "return_last": -3.0}
    assert rewards(steady)
    assert not rewards(steady | {"return_before": -3.3})
    assert not rewards(steady | {"return_first": -2.9})
    rising = {"model_first": -4.0, "model_last": -3.0, "model_rises": 0.8}
    assert models(rising)
    assert not models(rising | {"model_rises": 0.5})
    assert not models(rising | {"model_last": -5.0})
    peaks = {
        "peak_acceleration_first": 0.2,
        "peak_acceleration_last": 0.1,
        "peak_rate_first": 0.2,
        "peak_rate_last": 0.1,
    }
    assert curves(peaks)
    assert not curves(peaks | {"peak_rate_last": 0.3})


def test_the_table_has_median_range_and_verdict(run):
    other = run | {"seed": 8, "maneuvers": 35, "return_last": None}
    third = run | {"seed": 9, "maneuvers": 27}
    text = tabulate_statements([run, other, third, run | {"scenario": "paper"}])
    head, _, *lines = text.splitlines()
    assert head == "| the paper | here | touch | paper |"
    assert lines[0].endswith("| transitions [1,000] | 0.1 [0.1, 0.1] | 0.1 |")
    assert lines[1].endswith("| maneuvers in stage one | 27 [25, 35] | 25 |")
    assert any("| last tenth | -95 [-95, -95] (2 of 3 seeds) | -95" in line for line in lines)
    verdicts = [line for line in lines if "holds if" in line]
    assert len(verdicts) == len(STATEMENTS)
    assert "**holds in 0 of 3**" in verdicts[0]
    assert "**holds in 3 of 3**" in verdicts[1]
    # The peaks of the last model are not defined.
    assert verdicts[-1].count("**not defined**") == 2
