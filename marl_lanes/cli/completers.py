"""What the shell offers for an argument when TAB is pressed."""

import argparse
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from marl_lanes.cli.policies import UNTRAINED
from marl_lanes.scenario.dispositions import LEARNED, SCRIPTED
from marl_lanes.zoo.index import PREFIX, read_index

Completer = Callable[[str], Iterable[str]]
"""Given the beginning of a word, the words that it may become, and perhaps others."""


def offer(argument: argparse.Action, completer: Completer) -> None:
    """Let the shell offer these words for an argument; for others it offers files.

    Args:
        argument: of a command.
        completer: called when TAB is pressed.
    """

    def complete(prefix: str, **_: Any) -> Iterable[str]:
        return completer(prefix)

    argument.completer = complete  # type: ignore[attr-defined]


def scenarios(prefix: str) -> Iterator[str]:
    """Shipped names, and files."""
    from marl_lanes.scenario import list_scenarios

    yield from list_scenarios()
    yield from files(prefix)


def policies(prefix: str) -> Iterator[str]:
    """Policies without learning, those of the zoo, and files."""
    yield from UNTRAINED
    yield from zoo(prefix)
    yield from files(prefix)


def zoo(_: str) -> Iterator[str]:
    """Names of the zoo with their prefix."""
    return (PREFIX + name for name in read_index())


def followers(prefix: str) -> Iterator[str]:
    """Scripted and shipped followers, checkpoints after ``learned:``."""
    yield from SCRIPTED
    yield from ("brake-checker", "late-yielder", f"{LEARNED}:")
    begin = f"{LEARNED}:"
    if prefix.startswith(begin):
        rest = prefix.removeprefix(begin)
        yield from (begin + name for name in (*zoo(rest), *files(rest)))


def overrides(prefix: str) -> Iterator[str]:
    """Fields of a training with ``=``, and the names of recipes and scenarios after it."""
    from marl_lanes.recipes import FOLDER
    from marl_lanes.scenario.yaml_files import read_yaml

    yield from ("--help", "--cfg", "--import")
    for group in ("recipe", "collector"):
        names = sorted(path.stem for path in (FOLDER / group).glob("*.yaml"))
        yield from (f"{group}={name}" for name in names)
    if prefix.startswith("scenario="):
        yield from (f"scenario={name}" for name in scenarios(prefix.removeprefix("scenario=")))
    for path in ("config.yaml", "recipe/fast.yaml"):
        yield from _fields(read_yaml(FOLDER / path))


def files(prefix: str) -> Iterator[str]:
    """Files and folders that begin so; argcomplete would ask bash, which is not everywhere."""
    folder, separator, beginning = prefix.rpartition("/")
    # RuntimeError: a user without a home.
    with suppress(OSError, RuntimeError):
        for path in sorted(Path(folder + separator).expanduser().iterdir()):
            is_hidden = path.name.startswith(".") and not beginning
            if path.name.startswith(beginning) and not is_hidden:
                yield f"{folder}{separator}{path.name}{'/' * path.is_dir()}"


def _fields(section: Mapping[str, Any], above: str = "") -> Iterator[str]:
    for name, value in section.items():
        if isinstance(value, Mapping):
            yield from _fields(value, f"{above}{name}.")
        elif name != "defaults":
            yield f"{above}{name}="
