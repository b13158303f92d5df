"""The user's own modules, which are run: followers that they register, and policies."""

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from traceback import extract_tb
from typing import TYPE_CHECKING, Any

from marl_lanes.scenario.messages import shown

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from marl_lanes.scenario import Scenario

imported: list[str] = []
"""What ``import_modules`` has imported in this process; its workers need it, too."""


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


def import_modules(names: Sequence[str], folder: Path | None = None) -> None:
    """Import the user's modules.

    Args:
        names: dotted names, the values of --import.
        folder: that is also searched; None: the current one.

    Raises:
        ValueError: one is not a dotted name, cannot be found, or raises an error.
    """
    for name in names:
        if not _is_dotted(name):
            raise ValueError(f"--import {shown(name)}: must be the dotted name of a module")
        with _telling(f"--import {name}"):
            _import(name, folder)
        if name not in imported:
            imported.append(name)


def names_function(name: str) -> bool:
    """Whether a policy's name has the form MODULE:FUNCTION."""
    module, colon, function = name.partition(":")
    return bool(colon) and _is_dotted(module) and function.isidentifier()


def import_policy(name: str, scenario: "Scenario") -> "Callable[[NDArray[np.float32]], Any]":
    """The policy that a function of the user makes for a scenario.

    Args:
        name: MODULE:FUNCTION; the function is given the scenario, and returns a policy:
            observations (N, F) to actions (N, D).
        scenario: that it drives on.

    Returns:
        the policy, which refuses actions of another shape than (N, D).

    Raises:
        ValueError: the module or the function cannot be found, or raises an error.
    """
    import numpy as np

    from marl_lanes.traffic.roles.changer import CHANGER

    module, _, function = name.partition(":")
    with _telling(f"policy {name}"):
        policy = getattr(_import(module), function)(scenario)
    if not callable(policy):
        raise ValueError(f"policy {name}: must return a function, got {shown(policy)}")
    num_actions = len(CHANGER.act(scenario))

    def act(observations: "NDArray[np.float32]") -> "NDArray[np.float64]":
        with _telling(f"policy {name}"):
            actions = np.asarray(policy(observations), np.float64)
        wanted = (len(observations), num_actions)
        if actions.shape != wanted:
            raise ValueError(
                f"policy {name}: its actions have the shape {actions.shape}, must have {wanted}"
            )
        return actions

    return act


def _is_dotted(name: str) -> bool:
    return all(part.isidentifier() for part in name.split("."))


def _import(name: str, folder: Path | None = None) -> Any:
    # An installed command does not search the current folder for modules by itself.
    searched = str(folder or Path.cwd())
    sys.path.insert(0, searched)
    try:
        return import_module(name)
    finally:
        sys.path.remove(searched)


@contextmanager
def _telling(origin: str) -> Iterator[None]:
    """What the user's code raises, as one line that begins with ``origin``."""
    try:
        yield
    except (Exception, SystemExit) as error:
        raise ValueError(f"{origin}: {_describe(error)}") from None


def _describe(error: BaseException) -> str:
    """What a module of the user raised, and where."""
    if isinstance(error, ImportError):
        return str(error)
    (*_, last) = extract_tb(error.__traceback__)
    return f"{type(error).__name__}: {error} ({last.filename}, line {last.lineno})"
