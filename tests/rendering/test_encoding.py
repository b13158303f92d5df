import errno
import io
import os
import re
import signal
import subprocess
import sys
from fractions import Fraction

import numpy as np
import pytest
from films import describe, read_pictures
from systems import needs, needs_posix

from marl_lanes.extras import MissingExtraError
from marl_lanes.rendering import encoding as module
from marl_lanes.rendering.encoding import FilmError, encoding

SIZE = (320, 180)
RATES = {".mp4": Fraction(30), ".gif": Fraction(25, 2), ".png": Fraction(1)}


def pictures(number):
    """A red square that moves to the right over grey."""
    for index in range(number):
        picture = np.full((SIZE[1], SIZE[0], 3), (60, 70, 80), np.uint8)
        picture[80:100, 4 * index : 4 * index + 20] = (200, 40, 40)
        yield picture


def write(path, number):
    with encoding(path, SIZE, RATES[path.suffix]) as add:
        for picture in pictures(number):
            add(picture)


@pytest.mark.parametrize(("suffix", "number"), [(".mp4", 40), (".gif", 25), (".png", 1)])
def test_what_is_written_is_read_back(tmp_path, suffix, number):
    path = tmp_path / f"film{suffix}"
    write(path, number)
    found = read_pictures(path)
    assert found.shape == (number, SIZE[1], SIZE[0], 3)
    for before, after in zip(pictures(number), found, strict=True):
        # Colours that a lossy film keeps, away from edges.
        assert np.abs(before.astype(int) - after)[8::16, 8::16].mean() < 4.0
    square = np.argwhere(found[-1][90, :, 0] > 130)
    assert square.mean() == pytest.approx(4 * (number - 1) + 9.5, abs=1.0)
    if suffix != ".png":
        rate = re.search(r"([\d.]+) fps", describe(path))[1]
        assert float(rate) == RATES[suffix]
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("suffix", [".mp4", ".gif", ".png"])
def test_the_same_pictures_are_the_same_bytes(tmp_path, suffix):
    number = 1 if suffix == ".png" else 12
    for name in ("one", "other"):
        write(tmp_path / f"{name}{suffix}", number)
    one, other = ((tmp_path / f"{name}{suffix}").read_bytes() for name in ("one", "other"))
    assert one == other
    assert b"Lavf" not in one


def test_browsers_play_it_before_all_is_loaded(tmp_path):
    path = tmp_path / "film.mp4"
    write(path, 5)
    content = path.read_bytes()
    assert 0 < content.index(b"moov") < content.index(b"mdat")
    about = describe(path)
    assert "Video: h264" in about
    assert "yuv420p(tv, bt709, progressive)" in about


def write_and_stop(path):
    with encoding(path, SIZE, RATES[path.suffix]) as add:
        add(next(pictures(1)))
        raise KeyError("stopped")


@pytest.mark.parametrize("suffix", [".mp4", ".gif", ".png"])
def test_what_is_interrupted_leaves_what_was_there(tmp_path, suffix):
    path = tmp_path / f"film{suffix}"
    path.write_bytes(b"before")
    with pytest.raises(KeyError, match="stopped"):
        write_and_stop(path)
    assert path.read_bytes() == b"before"
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


@needs_posix
@pytest.mark.parametrize("number", [0, 300])
def test_an_ffmpeg_that_fails_is_an_error_and_no_file(tmp_path, monkeypatch, number):
    """It ends at once, or only after it has read everything."""
    script = tmp_path / "ffmpeg"
    wait = "" if number else "cat > /dev/null; "
    script.write_text(f"#!/bin/sh\n{wait}echo first >&2; echo the disk is full >&2; exit 3\n")
    script.chmod(0o755)
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(script))
    with pytest.raises(FilmError, match="ffmpeg could not write the film: the disk is full"):
        write(tmp_path / "film.mp4", number)
    assert [entry.name for entry in tmp_path.iterdir()] == ["ffmpeg"]


@needs_posix
def test_an_ffmpeg_that_stops_reading_but_says_that_all_is_well_is_an_error(tmp_path, monkeypatch):
    script = tmp_path / "ffmpeg"
    script.write_text("#!/bin/sh\nexit 0\n")
    script.chmod(0o755)
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(script))
    with pytest.raises(BrokenPipeError):
        write(tmp_path / "film.mp4", 300)
    assert [entry.name for entry in tmp_path.iterdir()] == ["ffmpeg"]


@pytest.mark.parametrize("name", ["film.avi", "film", "film.mp4.txt"])
def test_an_unknown_suffix_is_refused(tmp_path, name):
    with pytest.raises(FilmError, match=r"must end in \.mp4, \.gif or \.png"):
        write_anything(tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def write_anything(path):
    with encoding(path, SIZE, Fraction(1)):
        pytest.fail("it was begun")


@pytest.mark.parametrize(
    "picture", [np.zeros((180, 322, 3), np.uint8), np.zeros((180, 320, 3), np.float32)]
)
def test_a_picture_of_another_size_or_type_is_refused(tmp_path, picture):
    with (
        pytest.raises(ValueError, match="must be uint8"),
        encoding(tmp_path / "film.mp4", SIZE, Fraction(30)) as add,
    ):
        add(picture)
    assert list(tmp_path.iterdir()) == []


def test_a_missing_package_is_one_error(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(MissingExtraError, match=r"imageio_ffmpeg: .*marl-lanes\[view\]"):
        write(tmp_path / "film.mp4", 1)
    assert list(tmp_path.iterdir()) == []


@needs("mkfifo")
def test_what_windows_says_of_a_broken_pipe_is_one(tmp_path, monkeypatch):
    class Pipe(io.BytesIO):
        def write(self, _):
            raise OSError(errno.EINVAL, "Invalid argument")

    start = subprocess.Popen

    def popen(*given, **options):
        process = start(*given, **options)
        process.stdin.close()
        process.stdin = Pipe()
        return process

    monkeypatch.setattr(subprocess, "Popen", popen)
    monkeypatch.setattr(sys, "platform", "win32")
    with pytest.raises((BrokenPipeError, FilmError)):
        write(tmp_path / "film.mp4", 1)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(sys.platform == "win32", reason="no colons in names")
def test_a_name_that_looks_like_an_option_or_an_address(tmp_path):
    path = tmp_path / "-y:http:%03d.png"
    write(path, 1)
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


@pytest.mark.training
def test_ctrl_c_leaves_nothing(tmp_path):
    code = (
        "import numpy as np, pathlib\n"
        "from fractions import Fraction\n"
        f"from {module.__name__} import encoding\n"
        "with encoding(pathlib.Path('film.mp4'), (320, 180), Fraction(30)) as add:\n"
        "    for index in range(10**9):\n"
        "        add(np.zeros((180, 320, 3), np.uint8))\n"
        "        if index == 20:\n"
        "            print('begun', flush=True)\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
        text=True,
    )
    assert process.stdout.readline() == "begun\n"
    # As a terminal sends it: to the program and to its ffmpeg.
    os.killpg(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode != 0
    assert "KeyboardInterrupt" in err
    assert list(tmp_path.iterdir()) == []
