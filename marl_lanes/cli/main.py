"""The entry point: the parser of all commands, and errors as one line."""

import argparse
import sys
from collections.abc import Callable, Sequence

from marl_lanes.cli import comparisons, record, replay, report, scenarios, watch

COMMANDS = (scenarios, comparisons, record, replay, report, watch)
"""The modules of commands, in the order of the help; each has ``add(commands)``."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command.

    Args:
        arguments: without the program's name; by default those of the process.

    Returns:
        0 on success, 2 on bad input, which is one line on stderr.

    Raises:
        SystemExit: argparse refuses the arguments (2), or shows a help (0).
    """
    options = _make_parser().parse_args(arguments)
    try:
        run: Callable[[argparse.Namespace], None] = options.run
        run(options)
    except (ValueError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


def _make_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="marl-lanes", description="Multi-agent lane changes in interactive highway traffic."
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for module in COMMANDS:
        module.add(commands)
    return parser
