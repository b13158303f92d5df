"""The figures: their content, and that every file is an image."""

import re

import matplotlib
import numpy as np
import pytest

from marl_lanes import load_scenario
from marl_lanes.evaluation import figures
from marl_lanes.evaluation.figures import (
    check_figure,
    draw_crossplay,
    draw_gaps,
    draw_maneuver,
    draw_training,
)
from marl_lanes.evaluation.rollout import TRACE, Maneuver
from marl_lanes.traffic.machine.state import Outcome

PNG = b"\x89PNG\r\n\x1a\n"
NAMES = {"loss", "returns", "saved_models"}
HEADS = {
    "metrics.csv": "transitions,updates,stage,loss,sigma,num_ended,mean_return\n",
    "maneuvers.csv": "transitions,return,outcome\n",
    "evaluations.csv": "transitions,checkpoint,success_rate,completion_rate,mean_return\n",
}


def make_run(path, num_maneuvers=300, *, is_empty=False):
    """Tables of a run, with a batch without an update and a model that completed no maneuver."""
    rows = {
        "metrics.csv": "10,0,1,,0.05,0,\n20,5,1,0.5,0.05,1,-3.0\n30,9,2,0.25,0.04,1,-2.0\n",
        "maneuvers.csv": "".join(f"{i},{-3.0 - (i % 2)},1\n" for i in range(num_maneuvers)),
        "evaluations.csv": "15,step_1.pt,0.0,0.0,\n30,final.pt,0.75,1.0,-2.5\n",
    }
    for name, head in HEADS.items():
        (path / name).write_text(head + ("" if is_empty else rows[name]), encoding="utf-8")
    return path


@pytest.fixture
def drawn(monkeypatch):
    """Figures by file name, as they are saved."""
    kept, write = {}, figures.write_figure

    def keep(figure, *paths):
        kept.update({path.name: figure for path in paths})
        write(figure, *paths)

    monkeypatch.setattr(figures, "write_figure", keep)
    return kept


def check_files(folder, names):
    """Every figure is there as an SVG and as a PNG, and nothing else is."""
    assert {path.name for path in folder.iterdir()} == {
        f"{name}.{kind}" for name in names for kind in ("svg", "png")
    }
    for name in names:
        assert (folder / f"{name}.png").read_bytes().startswith(PNG)
        text = (folder / f"{name}.svg").read_text(encoding="utf-8")
        assert "<svg" in text
        assert text.endswith("</svg>\n")


def labels(figure):
    """Of the axes: a panel above another shares its axis of x."""
    found = [text for axes in figure.axes for text in (axes.get_xlabel(), axes.get_ylabel())]
    return [text for text in found if text]


def lines(figure, panel=0):
    return {line.get_label(): line for line in figure.axes[panel].get_lines()}


def stage_and_optimum(figure):
    """Positions of the dotted vertical and the dashed horizontal line."""
    found = figure.axes[0].get_lines()
    stage = [line.get_xdata()[0] for line in found if line.get_linestyle() == ":"]
    optimum = [line.get_ydata()[0] for line in found if line.get_linestyle() == "--"]
    return stage, optimum


def test_the_pictures_of_a_run(tmp_path, drawn):
    draw_training(make_run(tmp_path), 17, -2.25)
    check_files(tmp_path / "figures", NAMES)
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
    shares = lines(drawn["saved_models.png"], panel=1)
    assert shares["success"].get_xydata().tolist() == [[15.0, 0.0], [30.0, 75.0]]
    assert shares["completed"].get_ydata().tolist() == [0.0, 100.0]


def test_every_axis_has_a_unit(tmp_path, drawn):
    draw_training(make_run(tmp_path), 17, -2.25)
    scenario = load_scenario("paper")
    models = {"a": [maneuver(5, 0.25)], "b": [maneuver(3, 0.5)], "c": [maneuver(4, 0.1)]}
    draw_maneuver(tmp_path / "both", "Three models", models, scenario)
    draw_gaps([tmp_path / "gaps.png"], gaps_result())
    assert len(drawn) == 9
    for name, figure in drawn.items():
        assert len(labels(figure)) >= 2, name
        for text in labels(figure):
            assert re.search(r" \[(1|%|m|s|rad/s|rad/s²|m/s²)\]$", text), (name, text)


def test_the_same_data_gives_the_same_bytes(tmp_path):
    """Also for a user with settings of their own, and at another time."""
    folders = [tmp_path / "one", tmp_path / "two"]
    for folder, settings in zip(
        folders, ({}, {"font.size": 30.0, "xtick.labelsize": 30.0}), strict=True
    ):
        folder.mkdir()
        with matplotlib.rc_context(settings):
            draw_training(make_run(folder), 17, -2.25)
            draw_gaps([folder / "figures" / "gaps.svg"], gaps_result())
    first, second = (
        {path.name: path.read_bytes() for path in folder.glob("figures/*")} for folder in folders
    )
    assert len(first) == 7
    assert first == second


@pytest.mark.parametrize("num_maneuvers", [1, 7])
def test_few_maneuvers_have_a_shorter_mean(tmp_path, drawn, num_maneuvers):
    draw_training(make_run(tmp_path, num_maneuvers), 0, None)
    mean = lines(drawn["returns.png"])[f"running mean of {num_maneuvers}"]
    assert len(mean.get_xdata()) == 1
    assert stage_and_optimum(drawn["returns.png"])[1] == []


def test_a_run_without_a_row(tmp_path):
    draw_training(make_run(tmp_path, is_empty=True), 5, None)
    check_files(tmp_path / "figures", NAMES)


def maneuver(count, rate):
    rows = np.zeros(count, TRACE)
    rows["yaw_rate"] = rate
    rows["yaw_acceleration"] = np.arange(count)
    return Maneuver(0, 0, 7, Outcome.MISSED, 0, 0, 0.0, 1.0, False, -2.0, rows)


@pytest.mark.parametrize("count", [0, 5])
def test_two_models_on_one_maneuver(tmp_path, drawn, count):
    scenario = load_scenario("paper", {"time_step": 0.2})
    stem = tmp_path / "deep" / "both"
    first, last = [maneuver(count, 0.25), maneuver(2, 0.125)], [maneuver(3, -0.5)]
    draw_maneuver(stem, "Two models", {"early": first, "late": last}, scenario)
    check_files(stem.parent, ["both"])
    figure = drawn["both.png"]
    assert figure.axes[0].get_title(loc="left") == "Two models"
    early, late = (lines(figure, panel=1)[name] for name in ("early", "late"))
    drawn_rates = [line.get_ydata() for line in figure.axes[1].get_lines()]
    assert [0.125, 0.125] in [list(values) for values in drawn_rates]
    assert early.get_ydata().tolist() == [0.25] * count
    assert late.get_ydata().tolist() == [-0.5] * 3
    assert late.get_xdata() == pytest.approx([0.2, 0.4, 0.6])
    assert lines(figure)["late"].get_ydata().tolist() == [0.0, 1.0, 2.0]
    assert "rad/s²" in figure.axes[0].get_ylabel()
    assert "rad/s]" in figure.axes[1].get_ylabel()


def statistics(value, low=None, high=None):
    return {"value": value, "low": low, "high": high}


def crossplay_result(time):
    """Two changers, three kinds of follower; success of 0.0, 0.1, ... 0.5."""
    pairs = []
    for number, (changer, follower) in enumerate(
        (changer, follower) for changer in ("one", "two") for follower in ("kind", "none", "rude")
    ):
        found = {
            "success_rate": statistics(number / 10, 0.0, 0.875),
            "abort_or_miss_rate": statistics(0.25, 0.2, 0.3),
            "collision_rate": statistics(0.01, 0.0, 0.02),
            "mean_time_to_completion": time,
        }
        pairs.append({"changer": changer, "followers": follower, "statistics": found})
    return {
        "num_maneuvers": 40,
        "confidence": 0.95,
        "changers": {"one": "paper", "two": "paper"},
        "followers": {"kind": {}, "none": {}, "rude": {}},
        "pairs": pairs,
    }


@pytest.mark.parametrize("time", [statistics(5.5, 5.25, 6.0), statistics(None)])
def test_a_crossplay_is_four_heat_maps(tmp_path, drawn, time):
    path = tmp_path / "deep" / "pairs.png"
    draw_crossplay([path], crossplay_result(time))
    assert path.read_bytes().startswith(PNG)
    assert [file.name for file in path.parent.iterdir()] == ["pairs.png"]
    panels = [axes for axes in drawn["pairs.png"].axes if axes.get_images() and axes.get_xlabel()]
    assert [axes.get_title("left") for axes in panels] == [
        "success [%]",
        "aborted or missed [%]",
        "collided [%]",
        "time to complete [s]",
    ]
    success, aborted, collided, took = panels
    for axes in panels:
        assert [text.get_text() for text in axes.get_xticklabels()] == ["kind", "none", "rude"]
        assert [text.get_text() for text in axes.get_yticklabels()] == ["one", "two"]
        assert len(axes.texts) == 6
    # Row by row: a changer's row, a follower's column.
    values = np.asarray(success.get_images()[0].get_array())
    assert values == pytest.approx(np.array([[0.0, 10.0, 20.0], [30.0, 40.0, 50.0]]))
    cells = {text.get_position(): text.get_text() for text in success.texts}
    assert cells[2, 0] == "20.0\n[0.0, 87.5]"
    assert cells[0, 1] == "30.0\n[0.0, 87.5]"
    assert {text.get_text() for text in aborted.texts} == {"25.0\n[20.0, 30.0]"}
    defined = time["value"] is not None
    assert {text.get_text() for text in took.texts} == {"5.50\n[5.25, 6.00]" if defined else "-"}
    # The colour scale has a minimum range: 1 % of collisions must not look like 100 %.
    assert collided.get_images()[0].get_clim() == (0.0, 10.0)
    assert aborted.get_images()[0].get_clim() == (0.0, 25.0)
    assert success.get_images()[0].get_clim() == (0.0, 100.0)


def gaps_result():
    def found(offset, entry, abort):
        shown = {
            "time": [0.0, 0.1, 0.2, 0.3],
            "gap": [20.0, 20.0 + offset, 21.0, 22.0],
            "follower_acceleration": [None, offset, 0.5, 0.25],
            "entry_time": entry,
            "abort_time": abort,
        }
        return {"shown": shown}

    followers = {"kind": found(0.5, 0.1, None), "rude": found(-0.5, None, 0.2)}
    return {"maneuver": 4, "seed": 2, "scenario": "dense", "followers": followers}


def test_the_gap_under_every_kind_of_follower(tmp_path, drawn):
    draw_gaps([tmp_path / "gaps.svg"], gaps_result())
    assert b"<svg" in (tmp_path / "gaps.svg").read_bytes()
    gap, acceleration = drawn["gaps.svg"].axes
    assert lines(drawn["gaps.svg"])["kind"].get_ydata().tolist() == [20.0, 20.5, 21.0, 22.0]
    assert lines(drawn["gaps.svg"], 1)["rude"].get_ydata()[1:].tolist() == [-0.5, 0.5, 0.25]
    for axes, at_entry, at_abort in ((gap, 20.5, 21.0), (acceleration, 0.5, 0.5)):
        marks = {line.get_marker(): line for line in axes.get_lines() if line.get_marker() in "ox"}
        assert marks["o"].get_xydata().tolist() == [[0.1, at_entry]]
        assert marks["x"].get_xydata().tolist() == [[0.2, at_abort]]
        curves = {line.get_label(): line.get_color() for line in axes.get_lines()}
        assert marks["o"].get_color() == curves["kind"]
        assert marks["x"].get_color() == curves["rude"]
    assert [text.get_text() for text in gap.get_legend().get_texts()] == ["kind", "rude"]
    assert "[m]" in gap.get_ylabel()
    assert "[m/s²]" in acceleration.get_ylabel()


def test_a_picture_is_whole_or_not_there(tmp_path, monkeypatch):
    def fail(*_, **__):
        raise OSError("disk full")

    monkeypatch.setattr(figures.Figure, "savefig", fail)
    path = tmp_path / "pairs.png"
    path.write_bytes(b"before")
    with pytest.raises(OSError, match="disk full"):
        draw_crossplay([path], crossplay_result(statistics(5.0)))
    assert [file.read_bytes() for file in tmp_path.iterdir()] == [b"before"]


def test_paths_that_no_figure_can_go_to(tmp_path):
    for name in ("a.png", "deep/b.PDF", "c.svg"):
        check_figure(tmp_path / name)
    for name in (".", "a", "a.xyz"):
        with pytest.raises(ValueError, match=r"must be a file that ends in one of .*png"):
            check_figure(tmp_path / name)
