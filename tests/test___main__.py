"""``python -m marl_lanes``, and the modules below it that one may try."""

import subprocess
import sys

import pytest

from marl_lanes.cli.main import OVERVIEW


@pytest.mark.parametrize("module", ["marl_lanes", "marl_lanes.cli", "marl_lanes.cli.main"])
def test_the_module_is_the_command(module):
    command = [sys.executable, "-W", "error", "-m", module]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, f"{OVERVIEW}\n", "")
