"""Files that commands write: those that cannot be, and those that would replace another."""

import json
import os
import re
from pathlib import Path

import pytest
from cli.commands import FOLLOWERS
from systems import needs, needs_links

from marl_lanes.cli import outputs
from marl_lanes.cli.main import main
from marl_lanes.cli.outputs import (
    PRINTED,
    check_figures,
    check_outputs,
    check_trajectories,
    show_result,
)


def test_outputs_that_cannot_be_written_are_refused(tmp_path):
    good = [("--json", tmp_path / "new" / "x.json"), ("--figure", tmp_path / "x.svg")]
    check_outputs([*good, ("--json", None)], [None, "tuned-cascade", tmp_path / "x.json"])
    check_figures([tmp_path / "new" / "x.png", tmp_path / "x.svg"])
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(ValueError, match=r"^--json .*: must be a file, not a folder$"):
        check_outputs([("--json", tmp_path)], [])
    for figure in (tmp_path, tmp_path / "x.xyz"):
        with pytest.raises(ValueError, match="must be a file that ends in"):
            check_figures([tmp_path / "x.png", figure])


def test_a_result_is_shown_to_people_or_to_programs(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = {"success_rate": 0.5}
    show_result(None, result, "50 %")
    assert capsys.readouterr().out == "50 %\n"
    show_result(PRINTED, result, "50 %")
    assert json.loads(capsys.readouterr().out) == result
    assert list(tmp_path.iterdir()) == []
    show_result(Path("new/x.json"), result, "50 %")
    assert capsys.readouterr().out == "50 %\n"
    assert json.loads(Path("new/x.json").read_text(encoding="utf-8")) == result


def test_only_a_result_can_be_printed_instead_of_written(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("-").mkdir()
    check_outputs([("--json", PRINTED)], [])
    with pytest.raises(ValueError, match="--figure -: must be a file, not a folder"):
        check_outputs([("--figure", PRINTED)], [])


def test_a_figure_needs_matplotlib(capsys, folder, monkeypatch):
    monkeypatch.setattr(outputs, "find_spec", lambda _: None)
    assert main([*FOLLOWERS, "--figure", str(folder / "x.png")]) == 2
    assert "pip install 'marl-lanes[train]'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("rows.csv", "--trajectories rows.csv: must end in .parquet"),
        ("rows", "--trajectories rows: must end in .parquet"),
    ],
)
def test_a_file_of_trajectories_that_cannot_be_written(name, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        check_trajectories(Path(name))
    check_trajectories(Path("new.parquet"))
    check_trajectories(None)


@needs_links
def test_what_is_read_is_not_replaced(tmp_path):
    """Also under another name; a copy is another file."""
    read, link, copy = (tmp_path / name for name in ("read.pt", "link.pt", "copy.pt"))
    read.write_bytes(b"1")
    link.symlink_to(read)
    copy.hardlink_to(read)
    check_outputs([("--json", copy)], [read])
    for output in (read, link, tmp_path / "new" / ".." / "read.pt"):
        with pytest.raises(ValueError, match="must be another file: it is read, too"):
            check_outputs([("--json", output)], [read])
    new = tmp_path / "new.json"
    with pytest.raises(ValueError, match="must be another file: it is that of --json, too"):
        check_outputs([("--json", new), ("--figure", new)], [])


@needs("mkfifo")
def test_a_pipe_or_a_device_may_be_written_twice(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    check_outputs([("--json", pipe), ("--figure", pipe)], [])
    check_outputs([("--json", Path(os.devnull)), ("--figure", Path(os.devnull))], [])


def test_a_folder_that_cannot_be_written(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "access", lambda path, mode: path != tmp_path or not mode & os.W_OK)
    with pytest.raises(ValueError, match=f"the folder {re.escape(str(tmp_path))} cannot be"):
        check_outputs([("--json", tmp_path / "new" / "x.json")], [])
