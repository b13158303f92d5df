"""Films and stills, read back by ffmpeg."""

import re
import subprocess

import numpy as np
from imageio_ffmpeg import get_ffmpeg_exe


def describe(path):
    """What ffmpeg says of its pictures, for example h264 ..., 320x180, 30 fps."""
    done = subprocess.run(
        [get_ffmpeg_exe(), "-i", str(path)], capture_output=True, text=True, check=False
    )
    return next(line.strip() for line in done.stderr.splitlines() if "Video:" in line)


def read_pictures(path):
    """(frames, height, width, 3) uint8."""
    command = [get_ffmpeg_exe(), "-v", "error", "-i", str(path)]
    command += ["-fps_mode", "passthrough", "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    content = subprocess.run(command, capture_output=True, check=True).stdout
    width, height = (int(part) for part in re.search(r", (\d+)x(\d+)", describe(path)).groups())
    return np.frombuffer(content, np.uint8).reshape(-1, height, width, 3)
