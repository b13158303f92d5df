"""Files that are whole or not there, at whatever path."""

import errno
import os
import platform
import stat
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from systems import needs, needs_links, needs_path, needs_posix

from marl_lanes import files
from marl_lanes.files import (
    LockedError,
    copy_file,
    lock_folder,
    open_regular,
    write_atomically,
    write_json,
    write_text,
)

JSON = '{\n  "a": 1\n}\n'


def names(folder):
    return sorted(entry.name for entry in folder.iterdir())


@pytest.mark.parametrize("partly", [False, True])
def test_a_failed_write_leaves_the_old_file(tmp_path, partly):
    file = tmp_path / "file.txt"
    file.write_text("old", encoding="utf-8")

    def fail(temporary):
        if partly:
            temporary.write_text("half", encoding="utf-8")
        raise RuntimeError("disk full")

    with pytest.raises(RuntimeError, match="disk full"):
        write_atomically(file, fail)
    assert file.read_text(encoding="utf-8") == "old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["file.txt"]
    with pytest.raises(RuntimeError, match="disk full"):
        write_atomically(tmp_path / "new.txt", fail)
    assert [entry.name for entry in tmp_path.iterdir()] == ["file.txt"]


def test_a_write_replaces_the_old_file_at_once(tmp_path):
    file = tmp_path / "file.txt"
    file.write_text("old", encoding="utf-8")

    def write(temporary):
        temporary.write_text("new", encoding="utf-8")
        assert temporary.parent == tmp_path
        assert file.read_text(encoding="utf-8") == "old"

    write_atomically(file, write)
    assert file.read_text(encoding="utf-8") == "new"
    assert [entry.name for entry in tmp_path.iterdir()] == ["file.txt"]


@needs_path("/proc/self/fd")
def test_a_file_is_on_the_disk_before_it_has_its_name(tmp_path, monkeypatch):
    """After a power cut there is the old file or the new one, not an empty one."""
    done = []

    def sync(descriptor):
        path = Path(f"/proc/self/fd/{descriptor}").readlink()
        done.append((path, (tmp_path / "file.txt").exists()))

    monkeypatch.setattr(os, "fsync", sync)
    write_atomically(tmp_path / "file.txt", lambda temporary: temporary.write_text("new"))
    (file, folder) = done
    assert (file[0].parent, file[1]) == (tmp_path, False)
    assert folder == (tmp_path, True)


@needs_links
@needs("mkfifo")
def test_what_is_no_file_is_not_opened(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("/dev/zero")
    for path in (tmp_path / "pipe", tmp_path / "link", tmp_path):
        with pytest.raises(OSError, match="must be a regular file"):
            open_regular(path)
    with pytest.raises(FileNotFoundError):
        open_regular(tmp_path / "none")
    (tmp_path / "file").write_bytes(b"content")
    (tmp_path / "other").symlink_to("file")
    with open_regular(tmp_path / "other") as file:
        assert file.read() == b"content"


LOCKING = (
    "import sys; from pathlib import Path; from marl_lanes.files import LockedError, lock_folder\n"
    "try: file = lock_folder(Path(sys.argv[1]))\n"
    "except LockedError: print('locked')\n"
    "else: print('free')"
)


def test_a_folder_is_locked_for_other_processes_until_it_is_released(tmp_path):
    def ask():
        command = [sys.executable, "-c", LOCKING, str(tmp_path)]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout

    with lock_folder(tmp_path):
        assert ask() == "locked\n"
    assert ask() == "free\n"
    # A lock of a process that has ended does not count, its file neither.
    lock_folder(tmp_path).close()


@pytest.fixture
def windows(monkeypatch):
    """What the module would find there; returns the flags of the files that it opens to flush."""
    flags = []
    real_open = os.open
    monkeypatch.setattr(sys, "platform", "win32")
    monkeypatch.delattr(os, "chown", raising=False)
    monkeypatch.delattr(files, "fcntl", raising=False)
    monkeypatch.setattr(os, "open", lambda *given: flags.append(given[1]) or real_open(*given))
    return flags


@needs_posix
def test_windows_flushes_what_may_be_written_and_no_folder(tmp_path, windows):
    for text in ("1", "22"):
        write_json(tmp_path / "file.json", text)
    assert windows == [os.O_RDWR, os.O_RDWR]
    assert names(tmp_path) == ["file.json"]


@pytest.mark.parametrize("is_free", [True, False])
@needs_posix
def test_windows_locks_a_byte(tmp_path, windows, monkeypatch, is_free):  # noqa: ARG001
    calls = []

    def lock(descriptor, mode, number):
        calls.append((os.fstat(descriptor).st_size, mode, number))
        if not is_free:
            raise PermissionError(errno.EACCES, "Permission denied")

    there = SimpleNamespace(LK_NBLCK="no waiting", locking=lock)
    monkeypatch.setattr(files, "msvcrt", there, raising=False)
    if is_free:
        lock_folder(tmp_path).close()
    else:
        with pytest.raises(LockedError, match="another process"):
            lock_folder(tmp_path)
    assert calls == [(0, "no waiting", 1)]


def test_text_has_the_same_bytes_on_every_system(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "linesep", "\r\n")
    write_text(tmp_path / "file.txt", "a\nb\n")
    assert (tmp_path / "file.txt").read_bytes() == b"a\nb\n"


def test_json_holds_no_nan(tmp_path):
    with pytest.raises(ValueError, match="JSON"):
        write_json(tmp_path / "a.json", {"value": float("nan")})
    assert list(tmp_path.iterdir()) == []


def test_folders_above_a_file_are_made(tmp_path):
    write_json(tmp_path / "a" / "b" / "c.json", {"a": 1})
    assert (tmp_path / "a" / "b" / "c.json").read_text(encoding="utf-8") == JSON


def test_a_copy_has_the_bytes(tmp_path):
    (tmp_path / "one").write_bytes(b"\0\1")
    copy_file(tmp_path / "one", tmp_path / "other")
    assert (tmp_path / "other").read_bytes() == b"\0\1"


@needs_links
@pytest.mark.parametrize("is_there", [True, False])
def test_links_are_followed(tmp_path, is_there):
    disk, here = tmp_path / "disk", tmp_path / "here"
    disk.mkdir()
    here.mkdir()
    if is_there:
        (disk / "file.json").write_text("old", encoding="utf-8")
    (here / "second.json").symlink_to("../disk/file.json")
    (here / "first.json").symlink_to(here / "second.json")
    write_json(here / "first.json", {"a": 1})
    assert all(link.is_symlink() for link in here.iterdir())
    assert (disk / "file.json").read_text(encoding="utf-8") == JSON
    assert names(disk) == ["file.json"]
    assert names(here) == ["first.json", "second.json"]


@needs_links
def test_a_circle_of_links_is_refused(tmp_path):
    (tmp_path / "a").symlink_to("b")
    (tmp_path / "b").symlink_to("a")
    with pytest.raises(OSError, match="symbolic links"):
        write_json(tmp_path / "a", {})
    assert all(link.is_symlink() for link in tmp_path.iterdir())


@needs_posix
@pytest.mark.parametrize("mode", [0o600, 0o640, 0o444, 0o755])
def test_a_file_keeps_its_mode(tmp_path, mode):
    file = tmp_path / "file.json"
    file.write_text("old", encoding="utf-8")
    file.chmod(mode)
    write_json(file, {"a": 1})
    assert stat.S_IMODE(file.stat().st_mode) == mode
    assert file.read_text(encoding="utf-8") == JSON


@pytest.mark.skipif(
    getattr(os, "geteuid", lambda: 1)() != 0, reason="only root can give files away"
)
def test_a_file_keeps_its_owner(tmp_path):
    file = tmp_path / "file.json"
    file.write_text("old", encoding="utf-8")
    os.chown(file, 1234, 5678)
    write_json(file, {"a": 1})
    assert (file.stat().st_uid, file.stat().st_gid) == (1234, 5678)


@needs_posix
def test_a_new_file_has_the_mode_that_the_process_gives(tmp_path):
    before = os.umask(0o027)
    try:
        write_json(tmp_path / "file.json", {})
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "file.json").stat().st_mode) == 0o640


@pytest.fixture
def pipe(tmp_path):
    """A named pipe, and its reader."""
    path = tmp_path / "pipe.json"
    if not hasattr(os, "mkfifo"):
        pytest.skip("no mkfifo in os here")
    os.mkfifo(path)
    reader = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    yield path, reader
    os.close(reader)


@needs_links
@pytest.mark.parametrize("is_linked", [False, True])
def test_a_pipe_is_sent_the_content(tmp_path, pipe, is_linked):
    path, reader = pipe
    if is_linked:
        path = tmp_path / "link.json"
        path.symlink_to("pipe.json")
    write_json(path, {"a": 1})
    assert os.read(reader, 100) == JSON.encode()
    (tmp_path / "file").write_bytes(b"bytes")
    copy_file(tmp_path / "file", path)
    assert os.read(reader, 100) == b"bytes"
    assert stat.S_ISFIFO(path.stat().st_mode)
    assert path.is_symlink() is is_linked
    assert names(tmp_path) == sorted({"file", "pipe.json", path.name})


def test_a_pipe_is_sent_nothing_that_is_not_whole(pipe):
    path, reader = pipe

    def fail(temporary):
        temporary.write_text("half", encoding="utf-8")
        raise RuntimeError("no more")

    with pytest.raises(RuntimeError, match="no more"):
        write_atomically(path, fail)
    assert os.read(reader, 100) == b""


@needs_path("/dev/fd")
def test_an_open_descriptor_is_written_to():
    reader, writer = os.pipe()
    write_json(Path(f"/dev/fd/{writer}"), {"a": 1})
    assert os.read(reader, 100) == JSON.encode()
    os.close(reader)
    os.close(writer)


@needs_path("/dev/stdout")
def test_what_standard_output_goes_to_stays_that_file(tmp_path):
    program = (
        "from pathlib import Path; from marl_lanes.files import write_json\n"
        "print('before', flush=True); write_json(Path('/dev/stdout'), {'a': 1}); print('after')"
    )
    with (tmp_path / "output").open("w") as output:
        subprocess.run([sys.executable, "-c", program], stdout=output, check=True)
    assert (tmp_path / "output").read_text(encoding="utf-8") == f"before\n{JSON}after\n"
    assert names(tmp_path) == ["output"]


def test_a_folder_is_refused_before_any_work(tmp_path):
    with pytest.raises((IsADirectoryError, PermissionError)):
        write_atomically(tmp_path, lambda _: pytest.fail("written"))


def test_what_a_killed_process_left_behind_is_removed(tmp_path):
    program = (
        "import os, sys; from pathlib import Path\n"
        "from marl_lanes.files import write_atomically\n"
        "def die(temporary):\n"
        "    temporary.write_text('half'); os._exit(9)\n"
        "write_atomically(Path(sys.argv[1]), die)"
    )
    file = tmp_path / "[file].json"
    done = subprocess.run([sys.executable, "-c", program, str(file)], check=False)
    assert done.returncode == 9
    (left,) = names(tmp_path)
    number = left.rpartition(".")[2]
    kept = [
        f".[file].json.{platform.node()}.{os.getppid()}",
        f".[file].json.elsewhere.{number}",
        f".[file].json.{platform.node()}.notes",
        f".other.json.{platform.node()}.{number}",
    ]
    for name in kept:
        (tmp_path / name).write_text("", encoding="utf-8")
    write_json(file, {"a": 1})
    assert names(tmp_path) == sorted([*kept, "[file].json"])
