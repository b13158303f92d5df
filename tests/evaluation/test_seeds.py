"""Figures of several seeds: medians, the range as a band, and nothing where a seed has no value."""

import numpy as np
import pytest

from marl_lanes.evaluation import figures, seeds
from marl_lanes.evaluation.seeds import NUM_BINS, draw_losses, draw_models, draw_returns

HEADS = {
    "metrics.csv": "transitions,loss\n",
    "maneuvers.csv": "transitions,return,outcome\n",
    "evaluations.csv": "transitions,checkpoint,success_rate,mean_return\n",
}


def make_run(path, level, *, is_completed=True):
    """A training of 160 transitions whose numbers are all this level."""
    path.mkdir(parents=True)
    outcome = 1 if is_completed else 3
    rows = {
        "metrics.csv": "2,\n" + "".join(f"{at},{level}\n" for at in range(4, 162, 2)),
        "maneuvers.csv": "".join(f"{at},-{level},{outcome}\n" for at in range(2, 162, 2)),
        "evaluations.csv": f"80,a.pt,{level / 10},{-level if is_completed else ''}\n" * 2,
    }
    for name, head in HEADS.items():
        (path / name).write_text(head + rows[name], encoding="utf-8")
    return path


@pytest.fixture
def runs(tmp_path):
    """Three seeds in a scenario, and two in one in which nobody completes."""
    return {
        "touch": [make_run(tmp_path / f"t{level}", level) for level in (1, 2, 5)],
        "paper": [make_run(tmp_path / f"p{level}", level, is_completed=False) for level in (3, 4)],
    }


@pytest.fixture
def drawn(monkeypatch):
    """The figure, as it is saved."""
    kept, write = [], figures.write_figure

    def keep(figure, *paths):
        kept.append(figure)
        write(figure, *paths)

    monkeypatch.setattr(figures, "write_figure", keep)
    return kept


def line(figure, panel, label):
    return next(one for one in figure.axes[panel].get_lines() if one.get_label() == label)


def bands(figure, panel):
    """Lowest and highest value of each band."""
    found = [one.get_paths()[0].vertices[:, 1] for one in figure.axes[panel].collections]
    return [(heights.min(), heights.max()) for heights in found]


def test_the_loss_has_a_median_and_a_band(tmp_path, runs, drawn):
    draw_losses(tmp_path / "loss", runs, 80)
    assert {path.name for path in tmp_path.glob("loss.*")} == {"loss.svg", "loss.png"}
    (figure,) = drawn
    touch = line(figure, 0, "touch")
    # The first part has no row, the second no update.
    assert touch.get_xdata() == pytest.approx(np.arange(5.0, 161.0, 2.0))
    assert set(touch.get_ydata()) == {2.0}
    assert set(line(figure, 0, "paper").get_ydata()) == {3.5}
    assert bands(figure, 0) == [(1.0, 5.0), (3.0, 4.0)]


def test_returns_are_of_completed_maneuvers_alone(tmp_path, runs, drawn):
    draw_returns(tmp_path / "returns", runs, 80)
    (figure,) = drawn
    assert line(figure, 0, "touch").get_ydata().tolist() == [-2.0] * (NUM_BINS - 1)
    assert line(figure, 0, "paper: none").get_ydata().size == 0
    shares = [line(figure, 1, name).get_ydata() for name in ("touch", "paper")]
    assert [set(values) for values in shares] == [{100.0}, {0.0}]


def test_models_have_their_success_beside_their_return(tmp_path, runs, drawn):
    draw_models(tmp_path / "models", runs, 0)
    (figure,) = drawn
    assert line(figure, 0, "touch").get_ydata().tolist() == [-2.0, -2.0]
    assert line(figure, 0, "paper: none").get_ydata().size == 0
    assert line(figure, 1, "touch").get_ydata() == pytest.approx([20.0, 20.0])
    assert line(figure, 1, "paper").get_ydata() == pytest.approx([35.0, 35.0])
    assert bands(figure, 1)[0] == pytest.approx((10.0, 50.0))


def test_the_average_of_a_part():
    edges = np.array([0.0, 10.0, 20.0, 30.0])
    at, values = np.array([1.0, 2.0, 3.0, 25.0]), np.array([1.0, np.nan, 4.0, 7.0])
    assert seeds._average(edges, at, values) == pytest.approx([2.5, np.nan, 7.0], nan_ok=True)
