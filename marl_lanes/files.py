"""Files that are whole or not there: write to a temporary name, then rename."""

import errno
import glob
import json
import os
import platform
import shutil
import stat
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from io import BufferedReader, BufferedWriter
from pathlib import Path
from typing import Any

import psutil

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

LOCK_FILE = ".lock"
"""File of a folder that one process at a time may lock."""


class LockedError(OSError):
    """A folder that another process has locked."""


def open_regular(path: Path) -> BufferedReader:
    """Open a file to read its bytes.

    Raises:
        OSError: it cannot be opened, or is no file: the end of a pipe or a device may never come.
    """
    if not stat.S_ISREG(path.stat().st_mode):
        raise OSError(errno.EINVAL, "must be a regular file", str(path))
    return path.open("rb")


def lock_folder(path: Path) -> BufferedWriter:
    """Lock a folder for this process, until the file is closed or the process ends in any way.

    A record lock: a child process does not have it. The file stays; its presence means nothing.

    Args:
        path: of the folder, which is there.

    Raises:
        LockedError: another process has locked it.
        OSError: it cannot be written, or its disk has no locks.
    """
    file = (path / LOCK_FILE).open("ab")
    try:
        if sys.platform == "win32":
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        file.close()
        if error.errno in {errno.EACCES, errno.EAGAIN}:
            raise LockedError(error.errno, "another process is at work in it", str(path)) from None
        raise
    return file


def write_atomically(path: Path, write: Callable[[Path], object]) -> None:
    """Let ``write`` fill a temporary file, then put it in the place of ``path``, all of it at once.

    As ``replacing``, for what is written by one call.

    Args:
        path: to write; folders above it are made.
        write: given the temporary file's path.

    Raises:
        OSError: it is a folder, or cannot be written; what was there stays as it was.
    """
    with replacing(path) as temporary:
        write(temporary)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary file that takes the place of ``path`` at the end, all of it at once.

    If the body raises, what was there stays as it was. Links are followed. A file that is there
    keeps its mode and its owner; a new one has those that the process gives. It is on the disk
    before it has the name: after a power cut there is the old one or the new one. What is no file
    (a pipe, a device, an open descriptor as ``/dev/stdout``) stays, and is sent the content once
    that is whole.

    Args:
        path: to write; folders above it are made.

    Yields:
        the temporary file's path, which the body writes.

    Raises:
        OSError: it is a folder, or cannot be written; what was there stays as it was.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        before = path.stat()
    except FileNotFoundError:
        before = None
    descriptor = _find_descriptor(path)
    if descriptor is not None or (before is not None and not stat.S_ISREG(before.st_mode)):
        with _sent(path if descriptor is None else os.dup(descriptor)) as temporary:
            yield temporary
        return
    target = path.resolve()
    _remove_abandoned(target)
    temporary = target.with_name(f"{_prefix(target)}{os.getpid()}")
    try:
        yield temporary
        _flush(temporary)
        if sys.platform != "win32" and before is not None:
            with suppress(PermissionError):
                os.chown(temporary, before.st_uid, before.st_gid)
            with suppress(PermissionError):
                temporary.chmod(stat.S_IMODE(before.st_mode))
        temporary.replace(target)
        _flush(target.parent)
    finally:
        temporary.unlink(missing_ok=True)


def copy_file(source: Path, target: Path) -> None:
    """Copy a file's bytes to ``target``."""
    write_atomically(target, lambda temporary: shutil.copyfile(source, temporary))


def write_json(path: Path, data: Any) -> None:
    """Write ``data`` as indented JSON."""
    write_text(path, json.dumps(data, indent=2, allow_nan=False) + "\n")


def write_text(path: Path, text: str) -> None:
    """Write ``text`` as UTF-8, with the same bytes on every system."""
    write_atomically(
        path, lambda temporary: temporary.write_text(text, encoding="utf-8", newline="\n")
    )


def _flush(path: Path) -> None:
    """Wait until a file's content, or a folder's names, are on the disk."""
    mode = os.O_RDONLY
    if sys.platform == "win32":
        # Windows opens no folder, and flushes what may be written alone.
        if path.is_dir():
            return
        mode = os.O_RDWR
    descriptor = os.open(path, mode)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _find_descriptor(path: Path) -> int | None:
    """The descriptor of this process that is meant, as by ``/dev/stdout``, or None.

    Who has opened its file goes on writing there: another in its place would not be seen.
    """
    # Of Linux and of macOS.
    folders = {Path(f"/proc/{os.getpid()}/fd"), Path("/dev/fd")}
    while path.parent.resolve() not in folders:
        if not path.is_symlink():
            return None
        path = path.parent / path.readlink()
    return int(path.name) if path.name.isdecimal() else None


@contextmanager
def _sent(sink: Path | int) -> Iterator[Path]:
    # Opened first, a folder is refused before any work.
    with open(sink, "wb") as file, tempfile.TemporaryDirectory() as folder:  # noqa: PTH123
        whole = Path(folder) / "whole"
        yield whole
        with whole.open("rb") as content:
            shutil.copyfileobj(content, file)


def _prefix(target: Path) -> str:
    """Of the names of its temporary files; the process's number follows.

    With the machine's name: on a disk that machines share a number says nothing of others.
    """
    return f".{target.name}.{platform.node()}."


def _remove_abandoned(target: Path) -> None:
    """Remove the temporary files of processes that were killed."""
    prefix = _prefix(target)
    for path in target.parent.glob(f"{glob.escape(prefix)}*"):
        process = path.name.removeprefix(prefix)
        if process.isdecimal() and not psutil.pid_exists(int(process)):
            with suppress(OSError):
                path.unlink()
