"""Arguments that several commands share, and what is done with them first."""

import argparse
from typing import Any, TypeAlias

from marl_lanes.cli.policies import TRAINED, UNTRAINED
from marl_lanes.cli.values import MAX_SEED, file_name, whole_number
from marl_lanes.scenario.followers import SCRIPTED

Commands: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"
"""What a module of commands adds its parsers to."""


def add_policy(parser: argparse.ArgumentParser, *, is_required: bool) -> None:
    """Add CHECKPOINT and --policy, of which one is given; at most one, if none is required.

    Args:
        parser: the command's parser.
        is_required: whether one must be given.
    """
    policy = parser.add_mutually_exclusive_group(required=is_required)
    policy.add_argument("checkpoint", nargs="?", help=TRAINED)
    note = "" if is_required else " (default: tuned-cascade)"
    policy.add_argument(
        "--policy",
        choices=UNTRAINED,
        help="a policy without learning, instead of a checkpoint" + note,
    )


def add_followers(parser: argparse.ArgumentParser, **options: Any) -> None:
    """Add --followers.

    Args:
        parser: the command's parser.
        options: of argparse: ``required`` or ``default``.
    """
    note = f" (default: {' '.join(options['default'])})" if "default" in options else ""
    parser.add_argument(
        "--followers",
        nargs="+",
        metavar="FOLLOWER",
        help=f"{', '.join(SCRIPTED)}, learned:CHECKPOINT, learned:zoo:NAME, brake-checker, "
        "late-yielder, or a name given to register_follower" + note,
        **options,
    )


def add_traffic(parser: argparse.ArgumentParser, *, num_maneuvers: int) -> None:
    """Add --scenario, --maneuvers and --seed.

    Args:
        parser: the command's parser.
        num_maneuvers: the default of --maneuvers.
    """
    parser.add_argument("--scenario", default="paper", help="name or YAML file (default: paper)")
    parser.add_argument(
        "--maneuvers",
        type=whole_number(1),
        default=num_maneuvers,
        help=f"number of maneuvers (default: {num_maneuvers})",
    )
    add_seed(parser, default=0)


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
    """Add --json, a file for the results."""
    parser.add_argument("--json", type=file_name, help="also write the results to this file")


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
