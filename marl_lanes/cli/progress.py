"""How far a command is, on a terminal."""

import sys


class Progress:
    """Shows a percentage if stderr is a terminal.

    Args:
        activity: what the command does, shown before the percentage.
        total: the count that is 100 %.
    """

    def __init__(self, activity: str, total: int) -> None:
        self.activity = activity
        self.total = total
        self.is_shown = sys.stderr.isatty()
        self.last = -1

    def __call__(self, count: int) -> None:
        """Show ``count`` out of ``total``."""
        percent = 100 * count // self.total
        if self.is_shown and percent != self.last:
            self.last = percent
            print(f"\r{self._line(percent)}", end="", file=sys.stderr, flush=True)

    def close(self) -> None:
        """Clear the line."""
        if self.is_shown:
            print("\r" + " " * len(self._line(100)) + "\r", end="", file=sys.stderr)

    def _line(self, percent: int) -> str:
        return f"{self.activity} {percent:3d} %"
