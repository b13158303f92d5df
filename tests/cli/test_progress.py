"""The percentage on a terminal, and nothing elsewhere."""

import sys

import pytest

from marl_lanes.cli.progress import Progress


@pytest.mark.parametrize("is_terminal", [False, True])
def test_progress_is_shown_on_a_terminal_alone(capsys, monkeypatch, is_terminal):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: is_terminal, raising=False)
    show = Progress("driving", 400)
    for count in range(401):
        show(count)
    show.close()
    shown = capsys.readouterr().err
    if not is_terminal:
        assert shown == ""
        return
    assert shown.count("\r") == 103
    assert "\rdriving  50 %" in shown
    assert shown.endswith("\rdriving 100 %\r" + " " * 13 + "\r")
