"""What programs print: never the reason that their work is lost."""

import errno
import io
import os
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout, suppress
from typing import Any, TextIO, cast


def prepare_streams() -> None:
    """Let printing succeed whatever the terminal is; to be called first by a program.

    What the encoding of a stream lacks, also bytes of a path that are no text, is printed as an
    escape. A stream that was closed when the program began leads nowhere.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        stream = getattr(sys, name)
        if stream is None:
            # In this order each takes the descriptor that is missing, which else the next file
            # would get, and with it what others print there.
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: PTH123, SIM115
        elif mode == "w" and isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def say(text: str) -> None:
    """Print to standard output at once.

    A reader that has left, as ``head`` does, is no error: it has seen what it wanted.

    Args:
        text: one or several lines, without the last line's end.

    Raises:
        OSError: it cannot be printed, as where a disk is full.
    """
    try:
        print(text, flush=True)  # noqa: T201
    except OSError as error:
        _discard(sys.stdout)
        if not is_broken_pipe(error):
            raise OSError(f"standard output: {error.strerror}") from None


def is_broken_pipe(error: OSError) -> bool:
    """Whether nobody reads what was written: Windows says EINVAL of a pipe that it finds broken."""
    is_invalid = sys.platform == "win32" and error.errno == errno.EINVAL
    return isinstance(error, BrokenPipeError) or is_invalid


def warn(text: str) -> None:
    """Print to standard error at once, if that can be written: nothing better could be told."""
    with suppress(OSError):
        print(text, file=sys.stderr, flush=True)  # noqa: T201


def _discard(stream: TextIO) -> None:
    """Let what still waits to be printed go nowhere: else it fails again when Python ends."""
    with suppress(io.UnsupportedOperation), open(os.devnull, "w") as nowhere:  # noqa: PTH123
        os.dup2(nowhere.fileno(), stream.fileno())


@contextmanager
def lenient_streams() -> Iterator[None]:
    """Let no error of stdout or stderr end the block: all that matters is in files.

    A training runs on after ``| head`` has ended, after its terminal is closed, and when it was
    started without one.
    """
    prepare_streams()
    with ExitStack() as stack:
        for stream, redirect in ((sys.stdout, redirect_stdout), (sys.stderr, redirect_stderr)):
            stack.enter_context(redirect(cast("TextIO", _Lenient(stream))))
        yield


class _Lenient:
    """Writes to a stream until that fails, and from then on to nowhere."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        try:
            return self._stream.write(text)
        except OSError:
            _discard(self._stream)
            return len(text)

    def flush(self) -> None:
        try:
            self._stream.flush()
        except OSError:
            _discard(self._stream)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)
