"""The percentage on a terminal, and nothing elsewhere."""

import sys
from contextlib import suppress

import pytest

from marl_lanes.cli.progress import Progress


@pytest.mark.parametrize("is_terminal", [False, True])
def test_progress_is_shown_on_a_terminal_alone(capsys, monkeypatch, is_terminal):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: is_terminal, raising=False)
    with Progress("driving", 400) as show:
        for count in range(401):
            show(count)
    shown = capsys.readouterr().err
    if not is_terminal:
        assert shown == ""
        return
    assert shown.count("\r") == 103
    assert "\rdriving  50 %" in shown
    assert shown.endswith("\rdriving 100 %\r" + " " * 13 + "\r")


def test_the_line_is_cleared_before_the_one_of_an_error(capsys, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    with suppress(ValueError), Progress("driving", 2) as show:
        show(1)
        raise ValueError
    assert capsys.readouterr().err.endswith("\rdriving  50 %\r" + " " * 13 + "\r")


def test_a_terminal_that_is_gone_stops_nothing(monkeypatch):
    class Gone:
        def isatty(self):
            return True

        def write(self, _):
            raise OSError(5, "Input/output error")

    monkeypatch.setattr(sys, "stderr", Gone())
    with Progress("driving", 2) as show:
        show(1)
        show(2)
