"""The figures: what is drawn, and that every one is a picture."""

import numpy as np
import pytest

from marl_lanes import load_scenario
from marl_lanes.evaluation import figures
from marl_lanes.evaluation.figures import draw_maneuver, draw_training
from marl_lanes.evaluation.rollout import TRACE, Maneuver
from marl_lanes.traffic.state import Outcome

PNG = b"\x89PNG\r\n\x1a\n"
NAMES = {"loss.png", "returns.png", "saved_models.png"}
HEADS = {
    "metrics.csv": "transitions,updates,stage,loss,sigma,num_ended,mean_return\n",
    "maneuvers.csv": "transitions,return,outcome\n",
    "evaluations.csv": "transitions,checkpoint,mean_return,completion_rate,mean_num_steps\n",
}


def make_run(path, num_maneuvers=300, *, is_empty=False):
    """The tables of a run; a batch without an update, a model that completed nothing."""
    rows = {
        "metrics.csv": "10,0,1,,0.05,0,\n20,5,1,0.5,0.05,1,-3.0\n30,9,2,0.25,0.04,1,-2.0\n",
        "maneuvers.csv": "".join(f"{i},{-3.0 - (i % 2)},1\n" for i in range(num_maneuvers)),
        "evaluations.csv": "15,step_1.pt,,0.0,\n30,final.pt,-2.5,1.0,31.0\n",
    }
    for name, head in HEADS.items():
        (path / name).write_text(head + ("" if is_empty else rows[name]), encoding="utf-8")
    return path


@pytest.fixture
def drawn(monkeypatch):
    """Figures by file name, as they are saved."""
    kept, save = {}, figures._save

    def keep(figure, path):
        kept[path.name] = figure
        save(figure, path)

    monkeypatch.setattr(figures, "_save", keep)
    return kept


def lines(figure, panel=0):
    return {line.get_label(): line for line in figure.axes[panel].get_lines()}


def stage_and_optimum(figure):
    """Where the dotted vertical and the dashed horizontal line are."""
    found = figure.axes[0].get_lines()
    stage = [line.get_xdata()[0] for line in found if line.get_linestyle() == ":"]
    optimum = [line.get_ydata()[0] for line in found if line.get_linestyle() == "--"]
    return stage, optimum


def test_the_pictures_of_a_run(tmp_path, drawn):
    draw_training(make_run(tmp_path), 17, -2.25)
    assert set(drawn) == NAMES
    for name in NAMES:
        assert (tmp_path / "figures" / name).read_bytes().startswith(PNG)
    loss = drawn["loss.png"].axes[0]
    assert loss.get_yscale() == "log"
    assert loss.get_lines()[0].get_xydata().tolist() == [[20.0, 0.5], [30.0, 0.25]]
    assert stage_and_optimum(drawn["loss.png"]) == ([17], [])
    returns = lines(drawn["returns.png"])
    assert returns["maneuver"].get_ydata().tolist() == [-3.0, -4.0] * 150
    mean = returns["running mean of 200"]
    assert mean.get_xdata().tolist() == list(range(199, 300))
    assert mean.get_ydata() == pytest.approx(np.full(101, -3.5))
    assert stage_and_optimum(drawn["returns.png"]) == ([17], [-2.25])
    models = lines(drawn["saved_models.png"])["saved model"]
    assert models.get_xdata().tolist() == [15.0, 30.0]
    assert models.get_ydata()[1] == -2.5
    assert np.isnan(models.get_ydata()[0])
    assert stage_and_optimum(drawn["saved_models.png"]) == ([17], [-2.25])


@pytest.mark.parametrize("num_maneuvers", [1, 7])
def test_few_maneuvers_have_a_shorter_mean(tmp_path, drawn, num_maneuvers):
    draw_training(make_run(tmp_path, num_maneuvers), 0, None)
    mean = lines(drawn["returns.png"])[f"running mean of {num_maneuvers}"]
    assert len(mean.get_xdata()) == 1
    assert stage_and_optimum(drawn["returns.png"])[1] == []


def test_a_run_without_a_row(tmp_path, drawn):
    draw_training(make_run(tmp_path, is_empty=True), 5, None)
    assert set(drawn) == NAMES
    for name in NAMES:
        assert (tmp_path / "figures" / name).read_bytes().startswith(PNG)


def maneuver(count, rate):
    rows = np.zeros(count, TRACE)
    rows["yaw_rate"] = rate
    rows["yaw_acceleration"] = np.arange(count)
    return Maneuver(0, 0, Outcome.COMPLETED, 0, 0, 0.0, 1.0, False, rows)


@pytest.mark.parametrize("count", [0, 5])
def test_two_models_on_one_maneuver(tmp_path, drawn, count):
    scenario = load_scenario("paper", {"time_step": 0.2})
    path = tmp_path / "deep" / "both.png"
    draw_maneuver(path, maneuver(count, 0.25), maneuver(3, -0.5), ("early", "late"), scenario)
    assert path.read_bytes().startswith(PNG)
    figure = drawn["both.png"]
    early, late = (lines(figure, panel=1)[name] for name in ("early", "late"))
    assert early.get_ydata().tolist() == [0.25] * count
    assert late.get_ydata().tolist() == [-0.5] * 3
    assert late.get_xdata() == pytest.approx([0.2, 0.4, 0.6])
    assert lines(figure)["late"].get_ydata().tolist() == [0.0, 1.0, 2.0]
    assert "rad/s^2" in figure.axes[0].get_ylabel()
    assert "rad/s]" in figure.axes[1].get_ylabel()
