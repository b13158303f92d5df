from contextlib import closing

import imageio_ffmpeg
import pytest
from report.finished import trained

from marl_lanes import load_scenario
from marl_lanes.files import copy_file
from marl_lanes.report import first_and_last
from marl_lanes.report.first_and_last import draw_first_and_last, film_first_and_last
from marl_lanes.training.run_folder import FINAL_MODEL

pytestmark = pytest.mark.slow


def test_the_same_maneuver_twice(tmp_path):
    with closing(trained(tmp_path / "run")) as run:
        draw_first_and_last(run, load_scenario("paper"), seed=0)
        assert {path.suffix for path in run.figures.glob("first_and_last.*")} == {".svg", ".png"}
        film_first_and_last(run, load_scenario("paper"), seed=0)
        frames, seconds = imageio_ffmpeg.count_frames_and_secs(str(run.film))
        assert frames > 100
        assert 4.0 < seconds < 40.0


@pytest.mark.parametrize(
    ("chosen", "title", "labels"),
    [
        (0, "first saved model, chosen, and the last", ["first and final: 0", "last: 1,000"]),
        (500, "first saved, final and last model", ["first: 0", "final: 500", "last: 1,000"]),
        (1000, "first saved and the final", ["first: 0", "final and last: 1,000"]),
    ],
)
def test_the_last_model_is_beside_the_chosen_one(tmp_path, monkeypatch, chosen, title, labels):
    drawn = []
    monkeypatch.setattr(first_and_last, "draw_maneuver", lambda *given: drawn.append(given))
    with closing(trained(tmp_path / "run")) as run:
        copy_file(run.checkpoints / f"step_{chosen:09d}.pt", run.checkpoints / FINAL_MODEL)
        draw_first_and_last(run, load_scenario("paper"), seed=0)
    ((_, shown, models, _),) = drawn
    assert title in shown
    assert list(models) == [f"{label} transitions" for label in labels]
    assert all(len(maneuvers) == 1 for maneuvers in models.values())


def test_without_a_lane_change_there_is_no_film(tmp_path, capsys):
    with closing(trained(tmp_path / "run")) as run:
        scenario = load_scenario("paper", {"horizon": 1.0})
        film_first_and_last(run, scenario, seed=0)
        assert "no film" in capsys.readouterr().err
        assert not run.film.exists()
