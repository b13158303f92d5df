"""Arguments that several commands share, and what is done with them first."""

import argparse
import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeAlias

from marl_lanes.cli.policies import UNTRAINED
from marl_lanes.extras import need
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
    policy.add_argument("checkpoint", nargs="?", help="a checkpoint of a training")
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
        help=f"{', '.join(SCRIPTED)}, learned:CHECKPOINT, or a name given to register_follower"
        + note,
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
        type=int,
        default=num_maneuvers,
        help=f"number of maneuvers (default: {num_maneuvers})",
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the traffic (default: 0)")


def add_import(parser: argparse.ArgumentParser) -> None:
    """Add --import; ``import_modules`` takes its value, ``modules``."""
    parser.add_argument(
        "--import",
        action="append",
        default=[],
        dest="modules",
        metavar="MODULE",
        help="first import this module, which calls register_follower; the current folder is also "
        "searched; may be given more than once",
    )


def add_json(parser: argparse.ArgumentParser) -> None:
    """Add --json, a file for the results."""
    parser.add_argument("--json", type=Path, help="also write the results to this file")


def add_figure(parser: argparse.ArgumentParser, drawn: str, *, is_required: bool) -> None:
    """Add --figure, which may be given for each format; its value is ``figures``.

    Args:
        parser: the command's parser.
        drawn: what is drawn, for the help.
        is_required: whether one must be given.
    """
    parser.add_argument(
        "--figure",
        type=Path,
        action="append",
        required=is_required,
        default=None if is_required else [],
        dest="figures",
        metavar="FILE",
        help=f"draw {drawn} to this file, in the format of its ending; may be given more than once",
    )


def check_outputs(json: Path | None, figures: Sequence[Path] = ()) -> None:
    """Reject outputs that cannot be written, before anything is computed.

    Args:
        json: the value of --json.
        figures: the values of --figure.

    Raises:
        ValueError: a file is a folder, no figure can have its name, or matplotlib is missing.
    """
    if json is not None and json.is_dir():
        raise ValueError(f"--json {json}: must be a file, not a folder")
    if not figures:
        return
    if find_spec("matplotlib") is None:
        raise ValueError("--figure: needs matplotlib: pip install 'marl-lanes[train]'")
    from marl_lanes.evaluation.figures import check_figure

    for figure in figures:
        check_figure(figure)


def check_trajectories(path: Path | None) -> None:
    """Reject a file of trajectories that cannot be written, before anything is computed.

    Args:
        path: the value of --trajectories.

    Raises:
        ValueError: it is a folder, or not named as Parquet files are, or pyarrow is missing.
    """
    if path is None:
        return
    if path.suffix.lower() != ".parquet":
        raise ValueError(f"--trajectories {path}: must end in .parquet")
    if path.is_dir():
        raise ValueError(f"--trajectories {path}: must be a file, not a folder")
    need("pyarrow", "view")


def import_modules(names: Sequence[str]) -> None:
    """Import the user's modules, from the current folder, too.

    Args:
        names: dotted names, the values of --import.

    Raises:
        ValueError: one is not a dotted name, or cannot be imported.
    """
    # An installed command does not search the current folder for modules by itself.
    folder = str(Path.cwd())
    sys.path.insert(0, folder)
    try:
        for name in names:
            if not all(part.isidentifier() for part in name.split(".")):
                raise ValueError(f"--import {name}: must be the dotted name of a module")
            try:
                import_module(name)
            except ImportError as error:
                raise ValueError(f"--import {name}: {error}") from None
    finally:
        sys.path.remove(folder)
