"""The index of the zoo: which policies there are, what is known of them, and their files."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

PREFIX = "zoo:"
"""Begins a policy's name wherever a checkpoint is taken; what has it is no path."""

FOLDER = Path(__file__).parent
"""Where the files are."""

INDEX_FILE = "zoo.json"
"""File name of the index."""


class ZooError(ValueError):
    """A name that the zoo does not have, or a file that is not the one of the index."""


def read_index() -> Mapping[str, Mapping[str, Any]]:
    """What is known of each policy, by its name without the prefix, in the order of the index."""
    index: dict[str, dict[str, Any]] = json.loads((FOLDER / INDEX_FILE).read_text(encoding="utf-8"))
    return index


def find_entry(name: str) -> Mapping[str, Any]:
    """What is known of a policy.

    Args:
        name: with or without the prefix.

    Raises:
        ZooError: there is no such policy.
    """
    index = read_index()
    try:
        return index[name.removeprefix(PREFIX)]
    except KeyError:
        names = ", ".join(PREFIX + known for known in index)
        raise ZooError(f"no such policy in the zoo; allowed: {names}") from None


def find_file(name: str) -> Path:
    """The checkpoint of a policy, whose bytes are those that were measured.

    Args:
        name: with or without the prefix.

    Raises:
        ZooError: there is no such policy, or the file's checksum is another one.
        OSError: the file cannot be read.
    """
    wanted = find_entry(name)["sha256"]
    path = FOLDER / f"{name.removeprefix(PREFIX)}.pt"
    if hashlib.sha256(path.read_bytes()).hexdigest() != wanted:
        raise ZooError(
            f"its file {path.name} is not the one of the index {INDEX_FILE} (SHA-256): install the "
            "package anew"
        )
    return path
