"""``python -m marl_lanes.cli`` is the command ``marl-lanes``."""

import sys

from marl_lanes.cli.main import main

if __name__ == "__main__":
    sys.exit(main(program="python -m marl_lanes"))
