"""Ctrl-C, SIGTERM, a closed terminal: the main process ends what it is at, workers ignore them."""

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

# The last one comes when the terminal is closed.
if sys.platform == "win32":
    SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGBREAK)
else:
    SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@contextmanager
def note_interruptions() -> Iterator[list[int]]:
    """Let Ctrl-C (and a polite kill) finish the iteration at hand; a second one stops at once.

    What the process ignores (SIGHUP under ``nohup``) stays so. Outside the main thread Python has
    no signals: there nothing is noted.
    """
    received: list[int] = []

    def note(number: int, frame: Any) -> None:
        if received:
            signal.default_int_handler(number, frame)
        received.append(number)

    is_main = threading.current_thread() is threading.main_thread()
    previous = {number: signal.getsignal(number) for number in SIGNALS if is_main}
    # None: a handler that is not Python's, and could not be put back.
    kept = (signal.SIG_IGN, None)
    noted = {number: handler for number, handler in previous.items() if handler not in kept}
    for number in noted:
        signal.signal(number, note)
    try:
        yield received
    finally:
        for number, handler in noted.items():
            signal.signal(number, handler)


def ignore_interruptions() -> None:
    """Signals reach all processes of a terminal; the main one ends the others when it is done."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
