"""From pictures to files: MP4, GIF and PNG, by the ffmpeg that imageio-ffmpeg brings along.

ffmpeg is called here, and not through imageio-ffmpeg's writer, because that one does not notice
when ffmpeg fails: half a film would look like a whole one.
"""

import errno
import os
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from subprocess import DEVNULL, PIPE
from typing import IO, Any

import numpy as np

from marl_lanes.extras import need
from marl_lanes.files import replacing
from marl_lanes.rendering.painter import Picture
from marl_lanes.terminal import is_broken_pipe

Write = Callable[[Picture], None]
"""Adds a frame."""

# One thread, and neither dates nor versions of programs: same pictures, same bytes.
_REPEATABLE = ("-threads", "1", "-fflags", "+bitexact", "-flags:v", "+bitexact")

_BT709 = "color_primaries=bt709:color_trc=bt709:colorspace=bt709"
_MP4 = (
    *("-vf", f"scale=out_color_matrix=bt709:out_range=tv,format=yuv420p,setparams={_BT709}"),
    *("-c:v", "libx264", "-preset", "medium", "-crf", "20"),
    *("-movflags", "+faststart", "-f", "mp4"),
)
"""H.264 as every browser plays it, with the colours that were drawn."""

_PNG = ("-c:v", "png", "-f", "image2pipe")
_LOSSLESS = ("-c:v", "ffv1", "-f", "matroska")

_MAX_COLOURS = 128
"""Of a GIF; at most 256. Edges of text and cars are not seen to be worse, the file is smaller."""


class FilmError(ValueError):
    """A film that cannot be made; the message says why."""


@contextmanager
def encoding(path: Path, size: tuple[int, int], rate: Fraction) -> Iterator[Write]:
    """A function that adds frames to a new file, which is there only if all goes well.

    Args:
        path: .mp4, .gif, or .png for one frame.
        size: width and height of the pictures, even.
        rate: frames a second; of a .gif 100 / n, as it counts hundredths of a second.

    Yields:
        the function.

    Raises:
        FilmError: the suffix is unknown, or ffmpeg fails.
        MissingExtraError: imageio-ffmpeg is not installed.
        OSError: the file cannot be written.
    """
    suffix = path.suffix.lower()
    if suffix not in (".mp4", ".gif", ".png"):
        raise FilmError(f"{path}: must end in .mp4, .gif or .png")
    with replacing(path) as temporary:
        if suffix == ".gif":
            with tempfile.TemporaryDirectory() as folder:
                lossless = Path(folder) / "lossless.mkv"
                with _piped(_LOSSLESS, lossless, size, rate) as write:
                    yield write
                _write_gif(lossless, temporary)
        else:
            options = _MP4 if suffix == ".mp4" else _PNG
            with _piped(options, temporary, size, rate) as write:
                yield write


@contextmanager
def _piped(
    options: Sequence[str], path: Path, size: tuple[int, int], rate: Fraction
) -> Iterator[Write]:
    """Run ffmpeg on pictures from this process."""
    width, height = size
    source = ("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", str(rate))
    command = _command(*source, "-i", "-", *options, path=path)
    with (
        tempfile.TemporaryFile() as complaints,
        # Without a buffer, so that closing the pipe has nothing left to write.
        subprocess.Popen(  # noqa: S603
            command, bufsize=0, stdin=PIPE, stdout=DEVNULL, stderr=complaints
        ) as process,
    ):
        pipe: Any = process.stdin

        def write(picture: Picture) -> None:
            if picture.shape != (height, width, 3) or picture.dtype != np.uint8:
                wanted = (height, width, 3)
                found = f"{picture.dtype} {picture.shape}"
                raise ValueError(f"picture: {found}: must be uint8 {wanted}")
            left = np.ascontiguousarray(picture).data.cast("B")
            while left:
                try:
                    left = left[pipe.write(left) :]
                except OSError as error:
                    if is_broken_pipe(error):
                        raise BrokenPipeError(errno.EPIPE, os.strerror(errno.EPIPE)) from None
                    raise

        try:
            yield write
        except BrokenPipeError:
            pipe.close()
            _check(process.wait(), complaints)
            raise
        except BaseException:
            process.kill()
            raise
        pipe.close()
        _check(process.wait(), complaints)


def _write_gif(lossless: Path, path: Path) -> None:
    """One palette for all frames, then the frames; dithering would flicker and grow the file."""
    palette = lossless.with_name("palette.png")
    source = ("-i", str(lossless))
    colours = f"palettegen=max_colors={_MAX_COLOURS}:reserve_transparent=1"
    _run(*source, "-vf", colours, "-f", "image2pipe", "-c:v", "png", path=palette)
    use = "paletteuse=dither=none:diff_mode=rectangle"
    _run(*source, "-i", str(palette), "-lavfi", use, "-loop", "0", "-f", "gif", path=path)


def _run(*options: str, path: Path) -> None:
    with tempfile.TemporaryFile() as complaints:
        done = subprocess.run(  # noqa: S603
            _command(*options, path=path),
            stdin=DEVNULL,
            stdout=DEVNULL,
            stderr=complaints,
            check=False,
        )
        _check(done.returncode, complaints)


def _command(*options: str, path: Path) -> list[str]:
    program = need("imageio_ffmpeg", "view").get_ffmpeg_exe()
    return [program, "-v", "error", "-y", *options, "-an", *_REPEATABLE, f"file:{path}"]


def _check(code: int, complaints: IO[bytes]) -> None:
    if code:
        complaints.seek(0)
        lines = complaints.read().decode(errors="replace").strip().splitlines()
        reason = lines[-1] if lines else f"exit status {code}"
        raise FilmError(f"ffmpeg could not write the film: {reason}")
