"""Values of options: numbers and files as they are typed, or one line on what is allowed."""

from argparse import ArgumentTypeError
from collections.abc import Callable
from math import nan
from pathlib import Path

from marl_lanes.scenario.messages import shown

MAX_SEED = 2**64 - 1
MAX_NUMBER = 2**63 - 1


def whole_number(low: int = 0, high: int = MAX_NUMBER) -> Callable[[str], int]:
    """The type of an option for argparse: a whole number within limits.

    Args:
        low: the smallest that is allowed.
        high: the largest.
    """

    def parse(text: str) -> int:
        try:
            value = int(_plain(text))
        except ValueError:
            value = low - 1
        if not low <= value <= high:
            raise ArgumentTypeError(f"{shown(text)}: must be a whole number, {low} to {high}")
        return value

    return parse


def number(low: float, high: float, *, unit: str = "") -> Callable[[str], float]:
    """The type of an option for argparse: a finite number within limits.

    Args:
        low: the smallest that is allowed.
        high: the largest.
        unit: for the message.
    """

    def parse(text: str) -> float:
        try:
            value = float(_plain(text))
        except ValueError:
            value = nan
        if not low <= value <= high:
            message = f"{shown(text)}: must be a number, {low:g} to {high:g}{unit}"
            raise ArgumentTypeError(message)
        return value

    return parse


def file_name(text: str) -> Path:
    """The type of an option for argparse: the path of a file, which need not be there."""
    if not text.strip() or "\0" in text:
        raise ArgumentTypeError(f"{shown(text)}: must be the name of a file")
    return Path(text)


def _plain(text: str) -> str:
    """The text of a number, without what Python would also read as one.

    Raises:
        ValueError: there are spaces, or digits of other scripts.
    """
    if not text.isascii() or text != text.strip():
        raise ValueError
    return text
