"""Standard streams that may be closed: by who started the program, or by who read them."""

import os
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout, suppress
from io import UnsupportedOperation
from typing import Any, TextIO, cast


class _Lenient:
    """Writes to a stream until that fails, and from then on to nowhere."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        try:
            return self._stream.write(text)
        except OSError:
            self._drop()
            return len(text)

    def flush(self) -> None:
        try:
            self._stream.flush()
        except OSError:
            self._drop()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def _drop(self) -> None:
        """Python flushes at its end what is left: then there must be a place for it."""
        with suppress(UnsupportedOperation), open(os.devnull, "w") as nowhere:  # noqa: PTH123
            os.dup2(nowhere.fileno(), self._stream.fileno())


@contextmanager
def lenient_streams() -> Iterator[None]:
    """Let no error of stdout or stderr end the block: all that matters is in files.

    A training runs on after ``| head`` has ended, after its terminal is closed, and when it was
    started without one.
    """
    with ExitStack() as stack:
        for stream, redirect in ((sys.stdout, redirect_stdout), (sys.stderr, redirect_stderr)):
            # A closed descriptor is taken again by the next file, so that one must be nowhere.
            found = stream or stack.enter_context(open(os.devnull, "w"))  # noqa: PTH123
            stack.enter_context(redirect(cast("TextIO", _Lenient(found))))
        yield
