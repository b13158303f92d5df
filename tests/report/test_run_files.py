"""The files of a run: what is read, and one clear error for each that is not as it should be."""

import json
import os

import pytest
from report.runs import add_replays, make_run
from systems import needs, needs_links

from marl_lanes.report.run_files import ReportError, read_run


def test_what_is_read(tmp_path):
    run = make_run(tmp_path / "run", choice="step_000000200.pt")
    add_replays(run, 1, 17)
    (run / "replays" / "notes.html").write_text("", encoding="utf-8")
    found = read_run(run)
    assert found.evaluation.intervals["success_rate"].low == 0.4375
    assert [one.is_success for one in found.maneuvers] == [True, False, False, True]
    assert [one.failure_time for one in found.maneuvers] == [None, 23.5, 23.5, None]
    assert found.replays == {1, 17}
    assert found.has_film is False
    assert found.chosen == "step_000000200.pt"
    assert (found.scenario, found.command) == (str(run / "scenario.yaml"), "python train.py seed=0")
    assert found.seconds["seconds_evaluating"] == 9.5
    (run / "film.mp4").write_bytes(b"film")
    (run / "choice.json").unlink()
    assert read_run(run).has_film
    assert read_run(run).chosen is None


@pytest.mark.parametrize(
    "name", ["evaluation.json", "final_maneuvers.csv", "training.json", "command.txt"]
)
def test_a_run_that_is_not_finished(tmp_path, name):
    run = make_run(tmp_path / "run")
    (run / name).unlink()
    with pytest.raises(ReportError, match=f"has no {name}: it is not finished.*resume=.*run"):
        read_run(run)


def test_a_folder_without_a_run(tmp_path):
    for path in (tmp_path, tmp_path / "absent"):
        with pytest.raises(ReportError, match=r"must be a run folder; it has no scenario\.yaml"):
            read_run(path)


def link(run, name, target):
    (run / name).unlink(missing_ok=True)
    (run / name).symlink_to(target)


@needs("mkfifo")
@needs_links
@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("film.mp4", lambda run: link(run, "film.mp4", run.parent / "secret")),
        ("command.txt", lambda run: link(run, "command.txt", "../secret")),
        ("figures/loss.svg", lambda run: link(run, "figures/loss.svg", "/etc/hostname")),
        ("replays", lambda run: link(run, "replays", "..")),
        ("pipe", lambda run: os.mkfifo(run / "pipe")),
        ("nowhere", lambda run: link(run, "nowhere", "../nothing")),
    ],
)
def test_a_link_out_of_the_folder_and_a_pipe_are_refused(tmp_path, name, change):
    """The report must not show what a stranger's folder points at."""
    run = make_run(tmp_path / "run")
    (tmp_path / "secret").write_text("secret", encoding="utf-8")
    change(run)
    with pytest.raises(ReportError, match=rf"{name}: must be a file or a folder of its own"):
        read_run(run)


@needs_links
def test_a_folder_may_be_a_link_and_hold_links_to_its_own_files(tmp_path):
    run = make_run(tmp_path / "run")
    (run / "best.yaml").symlink_to("scenario.yaml")
    (tmp_path / "link").symlink_to("run")
    assert read_run(tmp_path / "link").command == "python train.py seed=0"


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("evaluation.json", "{", "evaluation.json: not readable as JSON"),
        ("evaluation.json", "[1]", "evaluation.json: must be a mapping"),
        ("evaluation.json", b"\xff\xff", "evaluation.json: cannot be read"),
        ("training.json", "[1]", "training.json: must be a mapping"),
        ("training.json", '{"seconds_a": "b"}', "seconds_a = 'b': must be a number"),
        ("evaluation.json", "[" * 100_000, "evaluation.json: not readable as JSON"),
        ("evaluation.json", "1" * 10_000, "evaluation.json: not readable as JSON"),
        ("config.yaml", b"\xff", "config.yaml: cannot be read"),
        (
            "final_maneuvers.csv",
            "road\n" + "x" * 200_000,
            "final_maneuvers.csv: not readable as CSV",
        ),
        ("final_maneuvers.csv", "road\n" + "1,2\n" * 4, "final_maneuvers.csv: "),
        ("training.json", f'{{"a": "{"b" * 200}"}}', "bbb...bbb"),
        ("choice.json", "{}", "choice.json: chosen: must be given"),
        ("final_maneuvers.csv", "road,command\n1,2\n", "has 1 maneuvers: must have the 4"),
        ("final_maneuvers.csv", "road\n" + "x\n" * 4, "road = 'x': must be a valid integer"),
    ],
)
def test_a_broken_file(tmp_path, name, text, message):
    run = make_run(tmp_path / "run")
    (run / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ReportError) as caught:
        read_run(run)
    assert message in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("num_maneuvers", 0, "num_maneuvers = 0: must be greater than or equal to 1"),
        ("confidence", 95, "confidence = 95: must be less than 1"),
        ("seed", "x", "seed = 'x': must be a valid integer"),
        ("intervals", {}, "intervals.success_rate: must be given"),
    ],
)
def test_a_wrong_number(tmp_path, field, value, message):
    run = make_run(tmp_path / "run")
    fields = json.loads((run / "evaluation.json").read_text(encoding="utf-8"))
    (run / "evaluation.json").write_text(json.dumps(fields | {field: value}), encoding="utf-8")
    with pytest.raises(ReportError) as caught:
        read_run(run)
    assert message in str(caught.value)
