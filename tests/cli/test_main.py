"""The entry point: arguments that argparse refuses, the help, and what is imported."""

import subprocess
import sys

import pytest
from cli.commands import EVALUATE

from marl_lanes.cli.main import main


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["train"],
        ["evaluate"],
        ["evaluate", "--policy", "perfect"],
        ["evaluate", "policy.pt", "--policy", "random"],
        [*EVALUATE, "--maneuvers", "many"],
        ["crossplay", "--changers", "random"],
        ["crossplay", "--followers", "neutral"],
        ["followers"],
        ["followers", "--figure", "x.png", "--policy", "perfect"],
    ],
)
def test_bad_arguments_end_with_2(capsys, arguments):
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "usage: marl-lanes" in captured.err


@pytest.mark.parametrize("command", ["evaluate", "crossplay", "followers"])
def test_help_ends_with_0(capsys, command):
    with pytest.raises(SystemExit) as caught:
        main([command, "--help"])
    assert caught.value.code == 0
    shown = capsys.readouterr().out
    assert "--maneuvers" in shown
    assert "--import MODULE" in shown


@pytest.mark.parametrize("arguments", [["scenarios"], ["--help"], ["evaluate", "--policy", "x"]])
def test_commands_that_do_not_drive_import_nothing_heavy(arguments):
    text = (
        "import sys\n"
        "from marl_lanes.cli.main import main\n"
        "try:\n"
        f"    main({arguments})\n"
        "finally:\n"
        "    heavy = {'numba', 'torch', 'pettingzoo', 'matplotlib'} & set(sys.modules)\n"
        "    print('heavy:', *sorted(heavy))\n"
    )
    command = [sys.executable, "-W", "error", "-c", text]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.stdout.splitlines()[-1] == "heavy:"
