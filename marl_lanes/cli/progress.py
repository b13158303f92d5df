"""How far a command is, on a terminal."""

import sys
from types import TracebackType
from typing import Self


class Progress:
    """Shows a percentage inside a ``with`` block, if stderr is a terminal.

    Args:
        activity: what the command does, shown before the percentage.
        total: the count that is 100 %, above 0.
    """

    def __init__(self, activity: str, total: int) -> None:
        self.activity = activity
        self.total = total
        self.is_shown = sys.stderr.isatty()
        self.last = -1

    def __enter__(self) -> Self:
        return self

    def __call__(self, count: int) -> None:
        """Show ``count`` out of ``total``."""
        percent = 100 * count // self.total
        if percent != self.last:
            self.last = percent
            self._write(f"\r{self._line(percent)}")

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Clear the line, also where an error's line comes next."""
        self._write("\r" + " " * len(self._line(100)) + "\r")

    def _write(self, text: str) -> None:
        if not self.is_shown:
            return
        try:
            sys.stderr.write(text)
            sys.stderr.flush()
        except OSError:  # the terminal has been closed
            self.is_shown = False

    def _line(self, percent: int) -> str:
        return f"{self.activity} {percent:3d} %"
