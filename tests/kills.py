"""Programs that are killed, or find the disk full, at a chosen one of their writes."""

import os
import signal
import sys
import traceback
import warnings
from pathlib import Path

import pytest

WRITING = os.O_WRONLY | os.O_RDWR


def kill():
    """End this process at once."""
    os.kill(os.getpid(), signal.SIGKILL)


def interrupt():
    """As Ctrl-C does."""
    os.kill(os.getpid(), signal.SIGINT)


def kill_within(size):
    """End this process in the next write that makes a file larger than this [bytes]."""

    def limit():
        signal.signal(signal.SIGXFSZ, signal.SIG_DFL)
        fill_disk(size)()

    return limit


def fill_disk(size):
    """From now on a write that makes a file larger than this [bytes] fails."""

    def limit():
        import resource

        _, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))

    return limit


def run_until(program, folder, options, number, act):
    """Run a program's main in a child of this process, and act at one of its writes.

    Args:
        program: the program as a module.
        folder: to run in; what is opened to write or renamed in it counts as a write.
        options: of the command line.
        number: of the write before which ``act`` is called.
        act: what to do then.

    Returns:
        the exit status as of ``subprocess``, and what was printed.
    """
    if not hasattr(os, "fork"):
        pytest.skip("no fork in os here")
    reader, writer = os.pipe()
    with warnings.catch_warnings():
        # Python says that threads do not live on in a child: none is needed there.
        warnings.simplefilter("ignore", DeprecationWarning)
        child = os.fork()
    if not child:
        status = 70
        try:
            os.dup2(writer, 1)
            os.dup2(writer, 2)
            os.close(writer)
            sys.stdout, sys.stderr = os.fdopen(1, "w"), os.fdopen(2, "w")
            _watch(folder / "run", number, act)
            os.chdir(folder)
            program.main(options)
            status = 0
        except SystemExit as end:
            sys.stderr.write(f"{end.code}\n")
            status = end.code if isinstance(end.code, int) else 1
        except BaseException:
            traceback.print_exc()
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(status)
    os.close(writer)
    with os.fdopen(reader, encoding="utf-8") as file:
        text = file.read()
    _, status = os.waitpid(child, 0)
    return os.waitstatus_to_exitcode(status), text


def _watch(folder, number, act):
    """Call ``act`` before the chosen write in the folder."""
    left = [number]

    def note(event, arguments):
        if event not in {"open", "os.rename"}:
            return
        path, _, flags = arguments[:3]
        is_write = event == "os.rename" or (isinstance(flags, int) and flags & WRITING)
        if is_write and isinstance(path, str | Path) and folder in (Path.cwd() / path).parents:
            left[0] -= 1
            if left[0] == 0:
                act()

    sys.addaudithook(note)
