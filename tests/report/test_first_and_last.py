from contextlib import closing

import imageio_ffmpeg
import pytest
from report.finished import trained

from marl_lanes import load_scenario
from marl_lanes.report.first_and_last import draw_first_and_last, film_first_and_last

pytestmark = pytest.mark.slow


def test_the_same_maneuver_twice(tmp_path):
    with closing(trained(tmp_path / "run")) as run:
        draw_first_and_last(run, load_scenario("paper"), seed=0)
        assert {path.suffix for path in run.figures.glob("first_and_last.*")} == {".svg", ".png"}
        film_first_and_last(run, load_scenario("paper"), seed=0)
        frames, seconds = imageio_ffmpeg.count_frames_and_secs(str(run.film))
        assert frames > 100
        assert 4.0 < seconds < 40.0


def test_without_a_lane_change_there_is_no_film(tmp_path, capsys):
    with closing(trained(tmp_path / "run")) as run:
        scenario = load_scenario("paper", {"horizon": 1.0})
        film_first_and_last(run, scenario, seed=0)
        assert "no film" in capsys.readouterr().err
        assert not run.film.exists()
