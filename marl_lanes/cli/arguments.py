"""Arguments that several commands share, and what is done with them first."""

import argparse
from collections.abc import Callable
from textwrap import dedent, indent
from typing import Any, TypeAlias

from marl_lanes.cli.completers import followers, offer, policies, scenarios
from marl_lanes.cli.policies import TRAINED, UNTRAINED
from marl_lanes.cli.values import MAX_SEED, file_name, whole_number
from marl_lanes.scenario.dispositions import SCRIPTED

Commands: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"
"""What a module of commands adds its parsers to."""

Run: TypeAlias = Callable[[argparse.Namespace], int | None]
"""Runs a command with its arguments; returns the status, None for 0."""

EXAMPLES = "examples:\n"
"""Begins the end of a command's help."""


class HelpFormatter(argparse.HelpFormatter):
    """Leaves text as it is that has lines of its own, such as examples."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        return text if "\n" in text else super()._fill_text(text, width, indent)


def add_command(
    commands: Commands,
    name: str,
    run: Run,
    *,
    summary: str,
    description: str,
    examples: str,
    **options: Any,
) -> argparse.ArgumentParser:
    """Add a command.

    Args:
        commands: what it is added to.
        name: of the command.
        run: what it does.
        summary: for the list of all commands.
        description: for its help.
        examples: command lines for its help, of at most 78 columns.
        options: of its ``ArgumentParser``.

    Returns:
        its parser, to which arguments are added.
    """
    parser = commands.add_parser(
        name,
        help=summary,
        description=description,
        epilog=EXAMPLES + indent(dedent(examples).strip(), "  "),
        formatter_class=HelpFormatter,
        **options,
    )
    parser.set_defaults(run=run)
    return parser


def add_policy(parser: argparse.ArgumentParser, *, is_required: bool) -> None:
    """Add CHECKPOINT and --policy, of which one is given; at most one, if none is required.

    Args:
        parser: the command's parser.
        is_required: whether one must be given.
    """
    policy = parser.add_mutually_exclusive_group(required=is_required)
    offer(policy.add_argument("checkpoint", nargs="?", help=TRAINED), policies)
    note = "" if is_required else " (default: tuned-cascade)"
    policy.add_argument(
        "--policy",
        choices=UNTRAINED,
        metavar="NAME",
        help=f"a policy without learning, instead: {', '.join(UNTRAINED)}{note}",
    )


def add_followers(parser: argparse.ArgumentParser, **options: Any) -> None:
    """Add --followers.

    Args:
        parser: the command's parser.
        options: of argparse: ``required`` or ``default``.
    """
    note = f" (default: {' '.join(options['default'])})" if "default" in options else ""
    argument = parser.add_argument(
        "--followers",
        nargs="+",
        metavar="FOLLOWER",
        help=f"{', '.join(SCRIPTED)}, learned:CHECKPOINT, learned:zoo:NAME, brake-checker, "
        "late-yielder, or a name given to register_follower" + note,
        **options,
    )
    offer(argument, followers)


def add_traffic(parser: argparse.ArgumentParser, *, num_maneuvers: int) -> None:
    """Add --scenario, --maneuvers and --seed.

    Args:
        parser: the command's parser.
        num_maneuvers: the default of --maneuvers.
    """
    add_scenario(parser, default="paper")
    parser.add_argument(
        "--maneuvers",
        type=whole_number(1),
        default=num_maneuvers,
        help=f"number of maneuvers (default: {num_maneuvers})",
    )
    add_seed(parser, default=0)


def add_scenario(
    parser: argparse.ArgumentParser, *, default: str | None, note: str = "paper"
) -> None:
    """Add --scenario.

    Args:
        parser: the command's parser.
        default: None where it matters whether it is given.
        note: what the help says of the default.
    """
    help_text = f"name or YAML file (default: {note})"
    offer(parser.add_argument("--scenario", default=default, help=help_text), scenarios)


def add_seed(parser: argparse.ArgumentParser, *, default: int | None) -> None:
    """Add --seed.

    Args:
        parser: the command's parser.
        default: 0, or None where it matters whether it is given.
    """
    parser.add_argument(
        "--seed",
        type=whole_number(0, MAX_SEED),
        default=default,
        help="seed of the traffic (default: 0)",
    )


def add_json(parser: argparse.ArgumentParser) -> None:
    """Add --json, a file for the results; ``outputs.show_result`` writes it."""
    parser.add_argument(
        "--json",
        type=file_name,
        metavar="FILE",
        help="also write the result to this file; - prints it as JSON instead",
    )


def add_figure(parser: argparse.ArgumentParser, drawn: str, *, is_required: bool) -> None:
    """Add --figure, which may be given for each format; its value is ``figures``.

    Args:
        parser: the command's parser.
        drawn: what is drawn, for the help.
        is_required: whether one must be given.
    """
    parser.add_argument(
        "--figure",
        type=file_name,
        action="append",
        required=is_required,
        default=None if is_required else [],
        dest="figures",
        metavar="FILE",
        help=f"draw {drawn} to this file, in the format of its ending; may be given more than once",
    )
