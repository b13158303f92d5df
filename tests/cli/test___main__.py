"""``python -m marl_lanes.cli`` names the command as it was called."""

import runpy
import sys

import pytest


def test_its_help_names_it(capsys, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["x", "evaluate", "--help"])
    with pytest.raises(SystemExit) as caught:
        runpy.run_module("marl_lanes.cli", run_name="__main__")
    assert caught.value.code == 0
    assert capsys.readouterr().out.startswith("usage: python -m marl_lanes evaluate [-h]")
