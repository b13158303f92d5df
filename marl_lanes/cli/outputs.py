"""Files that a command writes, checked before anything is computed."""

import errno
import json
import os
from collections.abc import Iterable, Sequence
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from marl_lanes.extras import need
from marl_lanes.files import write_json
from marl_lanes.scenario.messages import shown
from marl_lanes.terminal import say

Outputs = Sequence[tuple[str, Path | None]]
"""Each option with the file that it names, or None."""

PRINTED = Path("-")
"""The value of --json that prints the result."""

_MAX_NAME = 255
"""Characters of a file's name, on every system."""


def check_outputs(outputs: Outputs, inputs: Iterable[str | Path | None]) -> None:
    """Reject files that cannot be written, or that would replace another file of the command.

    Args:
        outputs: what the command writes.
        inputs: files that it reads; what is no file (a name, None) is passed over.

    Raises:
        ValueError: a file is a folder, is in no folder that can be written, is read by the command,
            or is the same as another one.
    """
    taken = {Path(one).resolve(): "read" for one in inputs if one and _is_file(one)}
    for option, path in outputs:
        if path is None or (option == "--json" and path == PRINTED):
            continue
        place = f"{option} {path}" if len(str(path)) < 1000 else f"{option} {shown(str(path))}"
        try:
            # Windows does not tell it before the file is written.
            if len(path.name) > _MAX_NAME:
                raise OSError(errno.ENAMETOOLONG, os.strerror(errno.ENAMETOOLONG))
            # A name of too many bytes, links in a circle.
            with suppress(FileNotFoundError, NotADirectoryError):
                path.stat()
            target = path.resolve()
            reason = _find_obstacle(path)
        except OSError as error:
            reason = str(error.strerror).lower()
        if reason is not None:
            raise ValueError(f"{place}: {reason}")
        # A pipe or a device may be given twice.
        if not path.exists() or path.is_file():
            if target in taken:
                raise ValueError(f"{place}: must be another file: it is {taken[target]}, too")
            taken[target] = f"that of {option}"


def show_result(path: Path | None, result: Any, text: str) -> None:
    """Show what a command has found.

    Args:
        path: the value of --json.
        result: plain values, for JSON.
        text: the same for people; with ``--json -`` it is not printed.
    """
    if path == PRINTED:
        say(json.dumps(result, indent=2, allow_nan=False))
        return
    if path is not None:
        write_json(path, result)
    say(text)


def check_figures(figures: Sequence[Path]) -> None:
    """Reject figures that cannot be drawn.

    Args:
        figures: the values of --figure.

    Raises:
        ValueError: no figure can have a file's name, or matplotlib is missing.
    """
    if not figures:
        return
    if find_spec("matplotlib") is None:
        raise ValueError("--figure: needs matplotlib: pip install 'marl-lanes[train]'")
    from marl_lanes.evaluation.figures import check_figure

    for figure in figures:
        check_figure(figure)


def check_trajectories(path: Path | None) -> None:
    """Reject a file of trajectories that cannot be written.

    Args:
        path: the value of --trajectories.

    Raises:
        ValueError: it is not named as Parquet files are, or pyarrow is missing.
    """
    if path is None:
        return
    if path.suffix.lower() != ".parquet":
        raise ValueError(f"--trajectories {path}: must end in .parquet")
    need("pyarrow", "view")


def _is_file(name: str | Path) -> bool:
    try:
        return Path(name).is_file()
    except (OSError, ValueError):
        return False


def _find_obstacle(path: Path) -> str | None:
    """Why the file cannot be written, or None."""
    if path.is_dir():
        return "must be a file, not a folder"
    above = next(folder for folder in path.absolute().parents if os.path.lexists(folder))
    if not above.is_dir():
        return f"{above} is no folder"
    if not os.access(above, os.W_OK | os.X_OK):
        return f"the folder {above} cannot be written"
    return None
