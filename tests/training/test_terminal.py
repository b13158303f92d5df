"""Standard streams that are closed, or whose reader has gone."""

import errno
import io
import os
import subprocess
import sys

import pytest

from marl_lanes.training.terminal import lenient_streams

TALK = """
import sys
from tqdm import tqdm
from marl_lanes.training.terminal import lenient_streams
with lenient_streams():
    for number in tqdm(range(2_000), mininterval=0, miniters=1, desc="x" * 50):
        print(number)
        print(number, file=sys.stderr)
    open("done", "w").write("yes")
"""


@pytest.mark.slow
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
