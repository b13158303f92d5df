"""Films and stills of recorded roads, several side by side on one clock."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from math import ceil, floor
from pathlib import Path

import numpy as np

from marl_lanes.rendering.encoding import FilmError, encoding
from marl_lanes.rendering.interpolation import Timeline
from marl_lanes.rendering.lettering import Lettering
from marl_lanes.rendering.loading import pygame
from marl_lanes.rendering.options import MIN_SIZE, ViewOptions
from marl_lanes.rendering.painter import Painter, Picture
from marl_lanes.rendering.palette import BACKGROUND, PANEL, TEXT
from marl_lanes.trajectory.frames import Frame

RATES = {".mp4": Fraction(30), ".gif": Fraction(25, 2)}
"""Frames a second of the film, by its suffix."""

_FADE = 0.55
"""Brightness of a road whose recording is over."""
_MIN_HEAD = 18
"""[pixel] Least height of the line above a road."""
_GAP = 4
"""[pixel] Between roads beside each other."""
_ROUNDING = 1e-6
"""[s]"""


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


def cut(
    title: str,
    frames: Iterable[Frame],
    start: float,
    end: float,
    follow: str | int | None = None,
) -> Clip:
    """The frames from one time to another [s]; the nearest one, if there is none.

    Args:
        title: of the clip.
        frames: of one road, ordered by time, at least one.
        start: first time.
        end: last time.
        follow: as in ``Clip``.
    """
    every = list(frames)
    chosen = [one for one in every if start - _ROUNDING <= one.time <= end + _ROUNDING]
    if not chosen:
        chosen = [every[-1] if every[-1].time < start else every[0]]
    return Clip(title, chosen, follow)


def choose_size(path: Path, number: int) -> tuple[int, int]:
    """A good size for a number of roads: .gif for a page of text, others for a screen.

    Args:
        path: of the film or still.
        number: of roads, >= 1.

    Returns:
        width and height [pixel].
    """
    width, height, row = (800, 450, 240) if path.suffix.lower() == ".gif" else (1280, 720, 320)
    columns, rows = _count_rows(number)
    return max(width, columns * (MIN_SIZE[0] + _GAP)), max(height, row * rows)


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


def arrange(number: int, size: tuple[int, int]) -> tuple[int, tuple[int, int], int]:
    """The grid of a number of roads: up to three below each other, as roads are long, not high.

    Args:
        number: of roads, at least 1.
        size: of the film [pixel].

    Returns:
        columns, the size of each road's picture, and the height of the line above it [pixel].

    Raises:
        FilmError: the pictures would be too small.
    """
    if number == 1:
        return 1, size, 0
    columns, rows = _count_rows(number)
    width = (size[0] - (columns - 1) * _GAP) // columns // 2 * 2
    head = 2 * max(_MIN_HEAD // 2, min(size[1] // (rows * 20), width // 50))
    height = size[1] // rows // 2 * 2 - head
    if width < MIN_SIZE[0] or height < MIN_SIZE[1]:
        needed = columns * (MIN_SIZE[0] + _GAP), rows * (MIN_SIZE[1] + _MIN_HEAD + 2)
        raise FilmError(
            f"size = {size}: must be at least {needed[0]} x {needed[1]} for {number} roads"
        )
    return columns, (width, height), head


def _count_rows(number: int) -> tuple[int, int]:
    """Columns and rows."""
    columns = 1 if number <= 3 else ceil(number**0.5)
    return columns, ceil(number / columns)


class _Screen:
    """Draws all clips at a time."""

    def __init__(self, clips: Sequence[Clip], view: ViewOptions) -> None:
        if not clips:
            raise FilmError("clips: must have at least one entry")
        self.size = view.size
        columns, size, head = arrange(len(clips), view.size)
        self._cells = []
        for clip in clips:
            follow = view.follow if clip.follow is None else clip.follow
            self._cells.append(_Cell(clip, replace(view, size=size, follow=follow), head))
        self._columns = columns
        self.start = min(cell.timeline.start for cell in self._cells)
        self.end = max(cell.timeline.end for cell in self._cells)

    def draw(self, time: float) -> Picture:
        """The picture at a time [s]."""
        picture = np.empty((self.size[1], self.size[0], 3), np.uint8)
        picture[:] = BACKGROUND
        for index, cell in enumerate(self._cells):
            own = cell.draw(time)
            row, column = divmod(index, self._columns)
            top, left = row * own.shape[0], column * (own.shape[1] + _GAP)
            picture[top : top + own.shape[0], left : left + own.shape[1]] = own
        return picture


class _Cell:
    """A clip's part of the screen: a line with the title, below it the road."""

    def __init__(self, clip: Clip, view: ViewOptions, head: int) -> None:
        self.timeline = Timeline(clip.frames)
        self._title = clip.title
        # The panel has no room for a title in a small picture.
        title = "" if head else clip.title
        self._painter = Painter(clip.frames[0].scenario, view, title=title)
        self._lettering = Lettering()
        self._head = head
        self._over: Picture | None = None

    def draw(self, time: float) -> Picture:
        """The picture at a time [s]."""
        if self._over is not None:
            return self._over
        frame = self.timeline.at(time)
        picture = self._painter.draw(frame)
        if not self._head:
            return picture
        # The film goes on for the others.
        is_over = time > self.timeline.end + _ROUNDING
        if not is_over:
            return np.concatenate([self._draw_head(""), picture])
        faded = (_FADE * picture).astype(np.uint8)
        self._over = np.concatenate([self._draw_head(f"ends at {frame.time:.1f} s"), faded])
        return self._over

    def _draw_head(self, note: str) -> Picture:
        width, size = self._painter.options.size[0], round(0.6 * self._head)
        surface = pygame.Surface((width, self._head), depth=32)
        surface.fill(PANEL)
        self._lettering.begin()
        middle = 0.5 * self._head
        put = self._lettering.put
        if note:
            put(surface, note, (width - middle, middle), size, TEXT, anchor="midright")
        room = width - 2 * self._head - self._lettering.measure(note, size)[0]
        title = self._lettering.shorten(self._title, size, room)
        put(surface, title, (middle, middle), size, TEXT, anchor="midleft")
        return pygame.surfarray.array3d(surface).swapaxes(0, 1)
