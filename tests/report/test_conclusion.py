import json
from contextlib import closing

import pytest
from report.finished import trained

from marl_lanes import load_scenario
from marl_lanes.report import conclusion
from marl_lanes.report.conclusion import conclude
from marl_lanes.training.config import EvaluationConfig

pytestmark = pytest.mark.slow


def settings(*, record):
    return EvaluationConfig(
        save_interval=1,
        num_maneuvers=1,
        final_num_maneuvers=20,
        seed=5,
        criterion=None,
        record=record,
    )


def test_everything_is_there_and_the_report_shows_it(tmp_path, monkeypatch):
    # test_first_and_last.py makes a true film, which takes ten seconds.
    monkeypatch.setattr(
        conclusion, "film_first_and_last", lambda run, *_: run.film.write_bytes(b"film")
    )
    with closing(trained(tmp_path / "run")) as run:
        summary = conclude(run, settings(record=True), load_scenario("paper"), 500)
        stored = json.loads((run.path / "evaluation.json").read_text(encoding="utf-8"))
        assert stored["success_rate"] == summary["success_rate"] > 0.9
        report = (run.path / "report.html").read_text(encoding="utf-8")
        assert "replays/road_0000.html" in report
        assert "data:video/mp4;base64," in report
        assert (run.path / "replays" / "road_0000.html").is_file()


def test_nothing_is_recorded_unless_it_is_wanted(tmp_path):
    with closing(trained(tmp_path / "run")) as run:
        conclude(run, settings(record=False), load_scenario("paper"), 0)
        assert (run.path / "report.html").is_file()
        assert not (run.path / "replays").exists()
        assert not run.film.exists()
