"""What programs print: never the reason that their work is lost."""

import io
import os
import sys
from contextlib import suppress


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
    except BrokenPipeError:
        _discard_output()
    except OSError as error:
        _discard_output()
        raise OSError(f"standard output: {error.strerror}") from None


def warn(text: str) -> None:
    """Print to standard error at once, if that can be written: nothing better could be told."""
    with suppress(OSError):
        print(text, file=sys.stderr, flush=True)  # noqa: T201


def _discard_output() -> None:
    """Let what still waits to be printed go nowhere: else it fails again when Python ends."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)
