"""Short labels of lane changers and followers, one for each, from what the user typed."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from marl_lanes.cli.policies import UNTRAINED


def label_changers(
    entries: Sequence[str], option: str = "--changers"
) -> dict[str, tuple[str, str | None]]:
    """Label to policy and scenario; None if the entry names no scenario.

    Args:
        entries: CHANGER or CHANGER@SCENARIO.
        option: that they are the values of, for messages.

    Returns:
        One entry for each of ``entries``, in their order.

    Raises:
        ValueError: an entry is repeated, or a part of it is empty.
    """
    _refuse_repeats(option, entries)
    found: dict[str, tuple[str, str | None]] = {}
    parts = {}
    for entry in entries:
        name, at, scenario = entry.rpartition("@")
        if not at or Path(entry).is_file():
            name, at, scenario = entry, "", ""
        elif not name or not scenario:
            raise ValueError(f"{option} {entry}: must be CHANGER or CHANGER@SCENARIO")
        found[entry] = name, scenario or None
        *folders, last = (name,) if name in UNTRAINED else _name_parts(name)
        parts[entry] = (*folders, last + at + Path(scenario).stem)
    labels = _shorten(parts)
    return {labels[entry]: value for entry, value in found.items()}


def label_followers(entries: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Label to the overrides of a scenario's ``followers``.

    Args:
        entries: names of followers, or learned:CHECKPOINT.

    Returns:
        One entry for each of ``entries``, in their order.

    Raises:
        ValueError: an entry is repeated, or has another form.
    """
    _refuse_repeats("--followers", entries)
    paths = {}
    for entry in entries:
        name, colon, path = entry.partition(":")
        if colon and (name != "learned" or not path):
            raise ValueError(f"--followers {entry}: must be a name, or learned:CHECKPOINT")
        if colon:
            paths[entry] = path
    labels = _shorten({entry: _name_parts(path) for entry, path in paths.items()})
    found: dict[str, dict[str, Any]] = {}
    for entry in entries:
        if entry in paths:
            override = {"mix": {"learned": 1.0}, "learned": {"checkpoint": paths[entry]}}
            found[f"learned:{labels[entry].removeprefix('learned:')}"] = override
        else:
            found[entry] = {"mix": {entry: 1.0}}
    return found


def as_text(name: str) -> str:
    """A name with escapes for bytes that are no text: such a label could not be drawn."""
    return name.encode("utf-8", "backslashreplace").decode("utf-8")


def saved_followers(followers: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """The checkpoints among ``label_followers``."""
    return [one["learned"]["checkpoint"] for one in followers.values() if "learned" in one]


def _refuse_repeats(option: str, entries: Sequence[str]) -> None:
    for entry, count in Counter(entries).items():
        if count > 1:
            raise ValueError(f"{option} {entry}: must be given once")


def _name_parts(path: str) -> tuple[str, ...]:
    """Parts of a checkpoint's name, the most specific last: run/checkpoints/final.pt is run."""
    file = Path(path)
    folders = [part for part in file.parent.parts if part != file.anchor]
    if len(folders) > 1 and folders[-1] == "checkpoints":
        *folders, run, _ = folders
        return (*folders, run if file.stem == "final" else f"{run}/{file.stem}")
    return (*folders, file.stem)


def _shorten(parts: Mapping[str, Sequence[str]]) -> dict[str, str]:
    """The shortest unique ending of each entry's parts; the entry itself if there is none."""
    depths = dict.fromkeys(parts, 1)
    while True:
        labels = {entry: "/".join(parts[entry][-depth:]) for entry, depth in depths.items()}
        counts = Counter(labels.values())
        shared = [entry for entry, label in labels.items() if counts[label] > 1]
        longer = [entry for entry in shared if depths[entry] < len(parts[entry])]
        if not longer:
            labels |= {entry: entry for entry in shared}
            return {entry: as_text(label) for entry, label in labels.items()}
        for entry in longer:
            depths[entry] += 1
