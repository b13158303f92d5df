"""Films and stills of recorded roads, several side by side on one clock."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from math import ceil, floor
from pathlib import Path

import numpy as np

from marl_lanes.rendering.encoding import FilmError, Picture, encoding
from marl_lanes.rendering.interpolation import Timeline
from marl_lanes.rendering.lettering import Lettering
from marl_lanes.rendering.loading import pygame
from marl_lanes.rendering.options import MAX_SIZE, MIN_SIZE, ViewOptions
from marl_lanes.rendering.painter import Painter
from marl_lanes.trajectory.frames import Frame

RATES = {".mp4": Fraction(30), ".gif": Fraction(25, 2)}
"""Frames a second of the film, by its suffix."""

_FADE = 0.55
"""Brightness of a road whose recording is over."""
_BORDER = 2
"""[pixel] Between the roads."""


@dataclass(frozen=True)
class Clip:
    """A road of a film.

    Args:
        title: what it shows.
        frames: of one road, ordered by time, at least one.
        follow: as in ``ViewOptions``; None: as the film's options say.
    """

    title: str
    frames: Sequence[Frame]
    follow: str | int | None = None


def write_film(
    path: Path,
    clips: Sequence[Clip],
    options: ViewOptions | None = None,
    *,
    progress: Callable[[int, int], object] | None = None,
) -> None:
    """Write a film of the clips, all at the same time of their roads.

    It lasts from the first frame of any clip to the last one of any, divided by the speed. Vehicles
    move smoothly between the time steps. A road whose frames are over stays, and says so. The same
    clips give the same bytes.

    Args:
        path: .mp4 or .gif.
        clips: at least one.
        options: of the view; the size is that of the film, which the clips share evenly.
        progress: called after every frame with the number of frames and how many there will be.

    Raises:
        FilmError: the suffix is unknown, there is too little room, or ffmpeg fails.
        MissingExtraError: a package of the extra ``view`` is not installed.
        OSError: the file cannot be written.
    """
    rate = RATES.get(path.suffix.lower())
    if rate is None:
        raise FilmError(f"{path}: must end in {' or '.join(RATES)}")
    view = ViewOptions.make(options)
    screen = _Screen(clips, view)
    # A film of one frame is no film, but what an excerpt of one step is.
    count = floor(round((screen.end - screen.start) / view.speed * float(rate), 6)) + 1
    with encoding(path, screen.size, rate) as write:
        for index in range(count):
            write(screen.draw(screen.start + index * view.speed / float(rate)))
            if progress is not None:
                progress(index + 1, count)


def write_still(
    path: Path, clips: Sequence[Clip], time: float, options: ViewOptions | None = None
) -> None:
    """Write a picture of the clips at a time.

    Args:
        path: .png.
        clips: at least one.
        time: [s]; a road that does not have it shows its nearest frame.
        options: as in ``write_film``.

    Raises:
        FilmError, MissingExtraError, OSError: as in ``write_film``.
    """
    if path.suffix.lower() != ".png":
        raise FilmError(f"{path}: must end in .png")
    screen = _Screen(clips, ViewOptions.make(options))
    with encoding(path, screen.size, Fraction(1)) as write:
        write(screen.draw(time))


def arrange(number: int, size: tuple[int, int]) -> tuple[int, int, int, int]:
    """The grid of a number of roads: those of a column have the whole width, up to three rows.

    Args:
        number: >= 1.
        size: of the film [pixel].

    Returns:
        columns, rows, and the width and height of each road's picture [pixel].

    Raises:
        FilmError: the pictures would be too small.
    """
    columns = 1 if number <= 3 else ceil(number**0.5)
    rows = ceil(number / columns)
    width = (size[0] - (columns - 1) * _BORDER) // columns // 2 * 2
    height = (size[1] - (rows - 1) * _BORDER) // rows // 2 * 2
    if width < MIN_SIZE[0] or height < MIN_SIZE[1]:
        needed = columns * (MIN_SIZE[0] + _BORDER), rows * (MIN_SIZE[1] + _BORDER)
        if needed[0] > MAX_SIZE[0] or needed[1] > MAX_SIZE[1]:
            raise FilmError(f"{number} roads: too many for one film")
        raise FilmError(
            f"size = {size}: must be at least {needed} for {number} roads side by side"
        )
    return columns, rows, width, height


class _Screen:
    """Draws all clips at a time."""

    def __init__(self, clips: Sequence[Clip], view: ViewOptions) -> None:
        if not clips:
            raise FilmError("clips: must have at least one entry")
        self.size = view.size
        columns, _, width, height = arrange(len(clips), view.size)
        self._cells = [
            _Cell(
                clip,
                replace(view, size=(width, height), follow=_or_else(clip.follow, view.follow)),
                (index % columns * (width + _BORDER), index // columns * (height + _BORDER)),
            )
            for index, clip in enumerate(clips)
        ]
        self.start = min(cell.timeline.start for cell in self._cells)
        self.end = max(cell.timeline.end for cell in self._cells)

    def draw(self, time: float) -> Picture:
        """The picture at a time [s]."""
        picture = np.zeros((self.size[1], self.size[0], 3), np.uint8)
        for cell in self._cells:
            left, top = cell.place
            own = cell.draw(time, is_last_shown=time <= self.start)
            picture[top : top + own.shape[0], left : left + own.shape[1]] = own
        return picture


class _Cell:
    """A clip's part of the screen."""

    def __init__(self, clip: Clip, view: ViewOptions, place: tuple[int, int]) -> None:
        self.timeline = Timeline(clip.frames)
        self.place = place
        self._painter = Painter(clip.frames[0].scenario, view, title=clip.title)
        self._over: Picture | None = None
