"""Ctrl-C and SIGTERM: the main process finishes what it is at, its workers leave that to it."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def note_interruptions() -> Iterator[list[int]]:
    """Let Ctrl-C (and a polite kill) finish the iteration at hand; a second one stops at once."""
    received: list[int] = []

    def note(number: int, frame: Any) -> None:
        if received:
            signal.default_int_handler(number, frame)
        received.append(number)

    previous = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield received
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def ignore_interruptions() -> None:
    """Ctrl-C reaches all processes of a terminal; the main one ends the others when it is done."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
