"""Bad calls of every command: one line that names option and value, status 2, and no file."""

import os

import pytest
from cli.bad_calls import CALLS, write_files

from marl_lanes.cli.main import main
from marl_lanes.scenario.messages import shown

MAX_LINE = 1200


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("calls")
    write_files(path)
    return path


def listing(top):
    """When each file was changed; what Python keeps of the imported modules does not count."""
    files = (path for path in top.rglob("*") if path.suffix != ".pyc")
    return {path: path.lstat().st_mtime_ns for path in files if not path.is_dir()}


def drive(*_, **__):
    raise AssertionError("driven, though the arguments are wrong")


@pytest.mark.parametrize("command", CALLS)
def test_a_bad_call_is_one_line_and_nothing_is_driven_or_written(
    capsys, folder, monkeypatch, command
):
    calls = CALLS[command]
    assert len({tuple(arguments) for arguments, _ in calls}) >= 80
    monkeypatch.chdir(folder)
    monkeypatch.setattr("marl_lanes.traffic.host.run", drive)
    before = listing(folder)
    has_links = (folder / "loop").is_symlink()
    for arguments, fragments in calls:
        if not has_links and any(one.startswith("loop") for one in arguments):
            continue
        status = main(arguments)
        captured = capsys.readouterr()
        call = f"{shown(arguments)}: {captured.err}"
        assert (status, captured.out) == (2, ""), call
        assert captured.err.startswith("error: "), call
        assert captured.err.endswith("\n"), call
        assert captured.err.count("\n") == 1, call
        assert captured.err.isprintable() or captured.err[:-1].isprintable(), call
        assert len(captured.err) < MAX_LINE, call
        told = captured.err + captured.err.replace(os.sep, "/")
        assert [one for one in fragments if one not in told] == [], call
        assert listing(folder) == before, call


@pytest.mark.parametrize("arguments", [["trian"], [""], ["--seed", "1"], ["x" * 5000]])
def test_a_command_must_be_named(capsys, arguments):
    assert main(arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("error: ")
    assert "COMMAND" in captured.err
    assert len(captured.err) < MAX_LINE
