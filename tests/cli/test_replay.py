"""The command that makes a replay."""

import json

import pytest
from cli.commands import assert_refused, files
from recordings import record

from marl_lanes.cli.main import main
from marl_lanes.trajectory.columns import new_rows
from marl_lanes.trajectory.file import Trajectory, write_trajectory

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def recorded():
    return record("paper", 150, num_envs=2)


@pytest.fixture
def trajectory(recorded, tmp_path):
    path = tmp_path / "roads.parquet"
    write_trajectory(path, recorded)
    return path


def held(path, name):
    """What the page holds as JSON."""
    text = path.read_text(encoding="utf-8")
    start = text.index(">", text.index(f'id="{name}"')) + 1
    return json.loads(text[start : text.index("</script>", start)])


def test_a_file_is_written(capsys, tmp_path, trajectory):
    out = tmp_path / "deep" / "replay.html"
    assert main(["replay", str(trajectory), "--out", str(out)]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    size = out.stat().st_size / 1e6
    assert captured.out == f"{out}: road 0 of 2, {size:.1f} MB\n"
    assert held(out, "header")["road"] == 0
    assert held(out, "optima")
    assert files(out.parent) == {"replay.html"}
    # The same command writes the same bytes.
    again = tmp_path / "again.html"
    assert main(["replay", str(trajectory), "--out", str(again)]) == 0
    assert again.read_bytes() == out.read_bytes()


def test_another_road_without_optima(tmp_path, trajectory, recorded):
    out = tmp_path / "replay.html"
    options = ["--road", "1", "--no-optimum"]
    assert main(["replay", str(trajectory), "--out", str(out), *options]) == 0
    assert held(out, "header")["road"] == 1
    assert held(out, "optima") == {}
    (chunk,) = held(out, "chunks")
    assert chunk["num_rows"] == recorded.rows_of(1).size


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--road", "2"], "road = 2: must be one of [0, 1]"),
        (["--out", "."], "--out .: must be a file, not a folder"),
    ],
)
def test_wrong_arguments_are_refused(capsys, tmp_path, trajectory, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    command = ["replay", str(trajectory), "--out", "x.html", *arguments]
    assert_refused(capsys, tmp_path, command, message)


def test_what_is_no_trajectory_is_refused(capsys, tmp_path, recorded):
    out = ["--out", str(tmp_path / "x.html")]
    absent = tmp_path / "absent.parquet"
    assert_refused(capsys, tmp_path, ["replay", str(absent), *out], "No such file")
    text = tmp_path / "text.parquet"
    text.write_text("no trajectory")
    assert_refused(capsys, tmp_path, ["replay", str(text), *out], "text.parquet: not readable")
    empty = tmp_path / "empty.parquet"
    write_trajectory(empty, Trajectory(recorded.metadata, new_rows(0)))
    assert_refused(capsys, tmp_path, ["replay", str(empty), *out], "empty.parquet: has no rows")
