"""The entry point: the parser of all commands, and errors as one line."""

import argparse
import sys
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

from marl_lanes.cli import (
    benchmark,
    comparisons,
    doctor,
    record,
    replay,
    report,
    scenarios,
    watch,
    zoo,
)
from marl_lanes.terminal import prepare_streams, say, warn

COMMANDS = (scenarios, zoo, comparisons, benchmark, record, replay, report, watch, doctor)
"""The modules of commands, in the order of the help; each has ``add(commands)``."""

INTERRUPTED = 130
"""The status of programs that Ctrl-C has ended."""

_MAX_LINE = 1000
"""[characters] Of the line about an error; of a longer one the middle is left out."""


def main(arguments: Sequence[str] | None = None, *, program: str = "marl-lanes") -> int:
    """Run the command.

    Args:
        arguments: without the program's name; by default those of the process.
        program: how the command is called, for its help.

    Returns:
        0 on success; 1 if ``doctor`` has found something wrong; 2 if the input is bad, or a file
        cannot be read or written, which is one line on stderr; 130 after Ctrl-C.

    Raises:
        SystemExit: a help was shown (0).
    """
    prepare_streams()
    try:
        options = make_parser(program).parse_args(arguments)
        run: Callable[[argparse.Namespace], int | None] = options.run
        return run(options) or 0
    except KeyboardInterrupt:
        _complain("interrupted")
        return INTERRUPTED
    except MemoryError:
        _complain("error: there is not enough memory for this")
    except (ValueError, OSError) as error:
        _complain(f"error: {error}")
    return 2


def make_parser(program: str = "marl-lanes") -> argparse.ArgumentParser:
    """The parser of all commands.

    Args:
        program: how the command is called.
    """
    parser = _Parser(
        prog=program, description="Multi-agent lane changes in interactive highway traffic."
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for module in COMMANDS:
        module.add(commands)
    return parser


class _Parser(argparse.ArgumentParser):
    """Refuses arguments in one line, as the commands refuse what is in their files."""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse; ``--option=--``, of which argparse would make an empty list, lacks its value."""
        for argument in sys.argv[1:] if args is None else args:
            if argument.startswith("-") and argument.endswith("=--"):
                self.error(f"{argument.removesuffix('=--')}: expected one argument")
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        """Refuse the arguments.

        Raises:
            ValueError: always.
        """
        raise ValueError(f"{message.removeprefix('argument ')}; see {self.prog} --help")

    def print_help(self, file: Any = None) -> None:
        """Print the help."""
        if file is None:
            say(self.format_help().rstrip("\n"))
        else:
            super().print_help(file)


def _complain(message: str) -> None:
    """Print one line on stderr."""
    text = " ".join(line.strip() for line in message.splitlines())
    # What would move the cursor, or is no text, as in a file's name, is shown as an escape.
    line = "".join(
        one if one.isprintable() else one.encode("unicode_escape").decode() for one in text
    )
    if len(line) > _MAX_LINE:
        line = f"{line[: _MAX_LINE // 2]} ... {line[-_MAX_LINE // 2 :]}"
    warn(line)


if __name__ == "__main__":
    sys.exit(main(program="python -m marl_lanes"))
