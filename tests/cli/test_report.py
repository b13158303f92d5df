"""The command that writes a run's report."""

from cli.commands import assert_refused
from report.runs import make_run

from marl_lanes.cli.main import main


def test_a_report_is_written_and_named(capsys, tmp_path):
    run = make_run(tmp_path / "run")
    assert main(["report", str(run)]) == 0
    assert capsys.readouterr() == (f"{run / 'report.html'}\n", "")
    assert (run / "report.html").is_file()


def test_what_is_no_run_is_refused(capsys, tmp_path):
    assert_refused(capsys, tmp_path, ["report", str(tmp_path)], "must be a run folder")
    run = make_run(tmp_path / "run")
    (run / "evaluation.json").unlink()
    assert_refused(capsys, tmp_path, ["report", str(run)], "it is not finished")
