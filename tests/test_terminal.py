"""Streams that cannot take what is printed: another encoding, closed, left by the reader, full."""

import errno
import io
import os
import subprocess
import sys

import pytest
from systems import needs_path, needs_posix

from marl_lanes.terminal import lenient_streams, prepare_streams, say

NAME = "räum \udcff 車"
ESCAPED = "r\\xe4um \\udcff \\u8eca"


@pytest.fixture
def output(monkeypatch):
    """Let standard output be a file descriptor."""

    def replace(descriptor):
        stream = os.fdopen(descriptor, "w", encoding="ascii")
        monkeypatch.setattr(sys, "stdout", stream)
        return stream

    return replace


@pytest.mark.parametrize("encoding", ["ascii", "cp1252", "utf-8"])
def test_what_an_encoding_lacks_is_escaped(monkeypatch, encoding):
    for name in ("stdout", "stderr"):
        monkeypatch.setattr(sys, name, io.TextIOWrapper(io.BytesIO(), encoding=encoding))
    prepare_streams()
    for stream in (sys.stdout, sys.stderr):
        stream.write(f"{NAME}\n")
        stream.flush()
        shown = stream.buffer.getvalue().decode(encoding).replace(os.linesep, "\n")
        lacks = {"ascii": ESCAPED, "cp1252": "räum \\udcff \\u8eca", "utf-8": "räum \\udcff 車"}
        assert shown == lacks[encoding] + "\n"


def test_a_reader_that_has_left_is_no_error(output):
    reader, writer = os.pipe()
    os.close(reader)
    with output(writer):
        say("one")
        say("two")
        sys.stdout.write("three")


def test_windows_says_of_such_a_pipe_that_something_is_invalid(monkeypatch):
    class Pipe(io.StringIO):
        def write(self, _):
            raise OSError(errno.EINVAL, "Invalid argument")

    monkeypatch.setattr(sys, "stdout", Pipe())
    monkeypatch.setattr(sys, "platform", "linux")
    with pytest.raises(OSError, match=r"^standard output: Invalid argument$"):
        say("one")
    monkeypatch.setattr(sys, "platform", "win32")
    say("two")


@needs_path("/dev/full")
def test_a_full_disk_is_one(output):
    with output(os.open("/dev/full", os.O_WRONLY)):
        with pytest.raises(OSError, match=r"^standard output: No space left on device$"):
            say("one")
        # What still waits is no second error.
        sys.stdout.write("two")


PROGRAM = """
import os, sys
from marl_lanes.terminal import prepare_streams, say
prepare_streams()
assert not sys.stderr.isatty()
say("shown")
print("told", file=sys.stderr)
new = os.open(sys.argv[1], os.O_WRONLY | os.O_CREAT)
assert new > 2, new
"""


@needs_posix
@pytest.mark.parametrize("closed", ["<&-", ">&-", "2>&-", "<&- >&- 2>&-"])
def test_streams_that_are_closed_lead_nowhere(tmp_path, closed):
    """The next file that is opened does not get what is printed."""
    file = tmp_path / "file"
    command = ["sh", "-c", f'exec "$0" -c "$1" "$2" {closed}', sys.executable, PROGRAM, str(file)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert file.read_bytes() == b""


TALK = """
import sys
from tqdm import tqdm
from marl_lanes.terminal import lenient_streams
with lenient_streams():
    for number in tqdm(range(2_000), mininterval=0, miniters=1, desc="x" * 50):
        print(number)
        print(number, file=sys.stderr)
    open("done", "w").write("yes")
"""


@pytest.mark.slow
@needs_posix
@pytest.mark.parametrize("redirection", ["2>&-", ">&-", "2>&1 | head -1", "2>/dev/full"])
def test_what_becomes_of_the_streams_ends_nothing(tmp_path, redirection):
    command = f'set -o pipefail; "{sys.executable}" -W error -c "$TALK" {redirection}'
    shell = ["bash", "-c", command]
    done = subprocess.run(
        shell, cwd=tmp_path, capture_output=True, text=True, env={**os.environ, "TALK": TALK}
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "done").read_text(encoding="utf-8") == "yes"
    assert "Error" not in done.stderr


class Broken(io.StringIO):
    def write(self, _):
        raise OSError(errno.EIO, "it is gone")


def test_what_can_be_written_is(capsys):
    before = sys.stdout, sys.stderr
    with lenient_streams():
        sys.stdout.write("one\n")
        sys.stderr.write("two\n")
        sys.stderr.flush()
        assert sys.stderr.isatty() is False
    assert capsys.readouterr() == ("one\n", "two\n")
    assert (sys.stdout, sys.stderr) == before


def test_an_error_of_a_stream_is_none_of_the_program(monkeypatch):
    monkeypatch.setattr(sys, "stderr", Broken())
    with lenient_streams():
        sys.stderr.write("two")
        sys.stderr.flush()
    with pytest.raises(OSError, match="gone"):
        sys.stderr.write("three")


def test_what_an_encoding_lacks_is_escaped_while_a_program_runs(monkeypatch):
    stream = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", stream)
    with lenient_streams():
        sys.stdout.write("läufe \udcff")
        sys.stdout.flush()
    assert stream.buffer.getvalue() == b"l\\xe4ufe \\udcff"
