"""``python -m marl_lanes``, and the modules below it that one may try."""

import subprocess
import sys

import pytest


@pytest.mark.parametrize("module", ["marl_lanes", "marl_lanes.cli", "marl_lanes.cli.main"])
def test_the_module_is_the_command(module):
    command = [sys.executable, "-W", "error", "-m", module]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    wanted = "error: the following arguments are required: COMMAND; see python -m marl_lanes --help"
    assert (done.returncode, done.stdout, done.stderr) == (2, "", f"{wanted}\n")
