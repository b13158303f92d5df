"""The entry point: the parser of all commands, and errors as one line."""

import argparse
import sys
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

import marl_lanes
from marl_lanes.cli import (
    benchmark,
    comparisons,
    completion,
    doctor,
    record,
    replay,
    report,
    scenarios,
    train,
    watch,
    zoo,
)
from marl_lanes.cli.arguments import HelpFormatter
from marl_lanes.terminal import prepare_streams, say, warn

COMMANDS = (
    watch,
    scenarios,
    zoo,
    comparisons,
    benchmark,
    record,
    replay,
    train,
    report,
    doctor,
    completion,
)
"""The modules of commands, in the order of the help; each has ``add(commands)``."""

INTERRUPTED = 130
"""The status of programs that Ctrl-C has ended."""

OVERVIEW = """\
Multi-agent lane changes in interactive highway traffic.

  marl-lanes watch tuned-cascade --open      a policy drives, in your browser
  marl-lanes evaluate zoo:paper              how well does a policy drive?
  marl-lanes train output=runs/first         train your own, and report on it

marl-lanes --help lists all commands, marl-lanes COMMAND --help explains one.
marl-lanes doctor says whether this installation works."""
"""What the command says that is called alone."""

_STATUSES = """\
exit status:
  0    all went well
  1    doctor or validate has found something wrong, or a training has failed
  2    the input is bad, or a file cannot be read or written: one line says why
  130  ended by Ctrl-C (0 after a training: it can be resumed)
"""

_MAX_LINE = 1000
"""[characters] Of the line about an error; of a longer one the middle is left out."""


def main(arguments: Sequence[str] | None = None, *, program: str = "marl-lanes") -> int:
    """Run the command.

    Args:
        arguments: without the program's name; by default those of the process.
        program: how the command is called, for its help.

    Returns:
        0 on success; 1 if ``doctor`` or ``validate`` has found something wrong; 2 if the input is
        bad, or a file cannot be read or written, which is one line on stderr; 130 after Ctrl-C.

    Raises:
        SystemExit: a help or the version was shown (0), or a training has ended with an error.
    """
    prepare_streams()
    try:
        parser = make_parser(program)
        completion.answer(parser)
        options = parser.parse_args(arguments)
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
        prog=program,
        description="Multi-agent lane changes in interactive highway traffic.",
        epilog=_STATUSES,
        formatter_class=HelpFormatter,
    )
    parser.add_argument("--version", action=_ShowVersion, nargs=0, help="print the version and end")
    parser.set_defaults(run=_introduce)
    commands = parser.add_subparsers(title="commands", metavar="COMMAND")
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


class _ShowVersion(argparse.Action):
    """Looks the version up when it is asked for."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        say(f"marl-lanes {marl_lanes.__version__}")
        parser.exit()


def _introduce(_: argparse.Namespace) -> None:
    say(OVERVIEW)


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
