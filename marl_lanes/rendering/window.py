"""A window that shows a road while it is simulated, with a keyboard and a mouse."""

import io
import itertools
import math
import os
import re
import time
from pathlib import Path
from weakref import WeakValueDictionary

import numpy as np

from marl_lanes.files import write_atomically
from marl_lanes.rendering.lettering import Lettering
from marl_lanes.rendering.loading import pygame
from marl_lanes.rendering.options import ViewOptions
from marl_lanes.rendering.painter import Painter
from marl_lanes.rendering.palette import MUTED, PANEL, TEXT
from marl_lanes.scenario import Scenario
from marl_lanes.trajectory.frames import Frame

KEYS = (
    "space: pause",
    "+ -: speed",
    "arrows, click: follow",
    "A: follow agents",
    "S: save picture",
    "Esc: close",
    ".: one step",
)
"""What the bar below the picture says; the first ones, as many as there is room for."""

SPEEDS = (1.0 / 16.0, 64.0)
"""Limits of the speed that the keys set, relative to real time."""

_SCREENLESS = ("dummy", "offscreen")
"""SDL's drivers without a screen. It chooses one by itself where there is no display."""

_PATIENCE = 100
"""[ms] A paused window looks at its keys at least so often."""

_windows: "WeakValueDictionary[int, Window]" = WeakValueDictionary()
"""The open windows by SDL's number; all of them share one queue of events."""


class DisplayError(RuntimeError):
    """A window is wanted where there is no display."""


class Window:
    """A window of one road, with a bar of its keys below the picture.

    Args:
        scenario: of the road.
        options: size of the picture, and the speed at the beginning.

    Raises:
        DisplayError: there is no display.
    """

    def __init__(self, scenario: Scenario, options: ViewOptions) -> None:
        _find_display()
        width, height = options.size
        text = min(max(height // 45, 10), 30)
        self._bar = pygame.Rect(0, height, width, 2 * text)
        title = f"marl-lanes: {scenario.name}"
        try:
            window = pygame.Window(title, (width, self._bar.bottom))
        except pygame.error as error:
            # A driver without a screen may begin all the same.
            if not _windows:
                pygame.display.quit()
            raise _refusal(str(error)) from None
        self._window: pygame.Window | None = window
        self._number = self._window.id
        _windows[self._number] = self
        self._lettering = Lettering()
        self._text_size = text
        self._time_step = scenario.time_step
        self._speed = options.speed
        self._is_paused = False
        self._is_stepping = False
        self._message = ""
        self._shown_at: float | None = None
        self._painter: Painter | None = None
        self._frame: Frame | None = None
        self._picture: pygame.Surface | None = None

    @property
    def is_open(self) -> bool:
        """Whether it can be seen; its user or ``close`` ends that for good."""
        return self._window is not None

    def show(self, painter: Painter, frame: Frame) -> None:
        """Show a time step, and return when it is time for the next one.

        Args:
            painter: draws the picture; the keys change whom it follows.
            frame: the time step.
        """
        self._painter, self._frame = painter, frame
        self._is_stepping = False
        self._draw()
        now = time.perf_counter()
        if self._shown_at is None:
            self._shown_at = now
        else:
            # The delays of single steps do not add up, but lost time is not made up.
            self._shown_at = max(self._shown_at + self._period, now - self._period)
        self.attend()
        while self.is_open and (wait := self._find_wait()) > 0:
            _deliver([pygame.event.wait(wait)])

    def attend(self) -> None:
        """Do what the keys and the mouse have asked for since the last time."""
        if self.is_open:
            _deliver(pygame.event.get())

    def close(self) -> None:
        """Close it for good."""
        if self._window is not None:
            _windows.pop(self._number, None)
            self._window.destroy()
            self._window = None

    def handle(self, event: "pygame.event.Event") -> None:
        """Do what an event of this window asks for."""
        if event.type == pygame.WINDOWCLOSE:
            self.close()
        elif event.type == pygame.WINDOWEXPOSED:
            self._flip()
        elif event.type == pygame.KEYDOWN:
            self._press(event.key, event.unicode.lower())
        elif event.type == pygame.MOUSEBUTTONDOWN and event.button == pygame.BUTTON_LEFT:
            self._click(event.pos)

    @property
    def _period(self) -> float:
        """For which a step is shown [s]."""
        return self._time_step / self._speed

    def _find_wait(self) -> int:
        """Until the next step [ms]; 0 if it is due."""
        if self._is_paused:
            return 0 if self._is_stepping else _PATIENCE
        if self._shown_at is None:
            return 0
        left = self._shown_at + self._period - time.perf_counter()
        return max(math.ceil(1000.0 * left), 0)

    def _press(self, key: int, letter: str) -> None:
        self._message = ""
        if key == pygame.K_ESCAPE:
            self.close()
        elif key == pygame.K_SPACE:
            self._is_paused = not self._is_paused
            self._shown_at = time.perf_counter()
        elif letter == ".":
            self._is_paused = self._is_stepping = True
        elif letter in ("+", "=", "-"):
            factor = 0.5 if letter == "-" else 2.0
            self._speed = min(max(self._speed * factor, SPEEDS[0]), SPEEDS[1])
        elif key in (pygame.K_LEFT, pygame.K_RIGHT):
            self._follow_next(1 if key == pygame.K_RIGHT else -1)
        elif letter == "a":
            self._follow(None)
        elif letter == "s":
            self._save()
        self._flip()

    def _click(self, place: tuple[int, int]) -> None:
        if self._painter is None or self._frame is None:
            return
        vehicle = self._painter.find_vehicle(self._frame, place)
        if vehicle is not None:
            self._follow(vehicle)
            self._flip()

    def _follow_next(self, direction: int) -> None:
        """Follow the next vehicle ahead (1) or behind (-1), from the rear to the front again."""
        if self._painter is None or self._frame is None or not self._frame.rows.size:
            return
        rows = self._frame.rows
        numbers = rows["vehicle"][np.argsort(rows["position"], kind="stable")].tolist()
        followed = self._painter.followed
        rank = numbers.index(followed) + direction if followed in numbers else 0
        self._follow(numbers[rank % len(numbers)])

    def _follow(self, vehicle: int | None) -> None:
        if self._painter is not None:
            self._painter.follow(vehicle)
            self._draw()

    def _save(self) -> None:
        """Write the picture to the working folder; the bar says its name, or why not."""
        if self._picture is None or self._frame is None:
            return
        name = re.sub(r"[^\w-]+", "_", self._frame.scenario.name)
        path = _find_free(f"{name}-{self._frame.step:06d}")
        content = io.BytesIO()
        pygame.image.save(self._picture, content, "png")
        try:
            write_atomically(path, lambda file: file.write_bytes(content.getvalue()))
        except OSError as error:
            self._message = f"not saved: {error.strerror}"
        else:
            self._message = f"saved {path}"

    def _draw(self) -> None:
        """Draw the time step, and show it."""
        if self._painter is not None and self._frame is not None:
            array = self._painter.draw(self._frame)
            height, width, _ = array.shape
            self._picture = pygame.image.frombytes(array.tobytes(), (width, height), "RGB")
        self._flip()

    def _flip(self) -> None:
        """Show the picture as it is, with the bar."""
        if self._window is None or self._picture is None:
            return
        surface = self._window.get_surface()
        surface.blit(self._picture, (0, 0))
        surface.fill(PANEL, self._bar)
        self._lettering.begin()
        state = f"{self._speed:g}x" + (", paused" if self._is_paused else "")
        size, gap = self._text_size, self._text_size
        right = (self._bar.right - gap, self._bar.centery)
        said = ", ".join(filter(None, (self._message, state)))
        self._lettering.put(surface, said, right, size, TEXT, anchor="midright", within=self._bar)
        left = self._bar.left + gap
        for key in KEYS:
            place = (left, self._bar.centery)
            box = self._lettering.put(
                surface, key, place, size, MUTED, anchor="midleft", within=self._bar
            )
            if box is None:
                break
            left = box.right + 2 * gap
        self._window.flip()


def _find_display() -> None:
    """Start pygame's video, with a screen or with the driver that SDL_VIDEODRIVER names.

    Raises:
        DisplayError: there is no display.
    """
    try:
        pygame.display.init()
        driver = pygame.display.get_driver()
    except pygame.error as error:
        reason = str(error)
    else:
        if driver not in _SCREENLESS or os.environ.get("SDL_VIDEODRIVER") == driver:
            return
        pygame.display.quit()
        reason = f"SDL has only its driver {driver!r}, which shows nothing"
    raise _refusal(reason)


def _refusal(reason: str) -> DisplayError:
    return DisplayError(
        f"render_mode = 'human': no display for a window ({reason}); use 'rgb_array' here, or set "
        "DISPLAY"
    )


def _deliver(events: "list[pygame.event.Event]") -> None:
    """Give each event to the window that it is for."""
    for event in events:
        if event.type == pygame.QUIT:
            for window in list(_windows.values()):
                window.close()
            continue
        target = getattr(event, "window", None)
        owner = None if target is None else _windows.get(target.id)
        if owner is not None:
            owner.handle(event)


def _find_free(stem: str) -> Path:
    """A name for a picture that no file has yet."""
    names = itertools.chain([stem], (f"{stem}-{number}" for number in itertools.count(2)))
    return next(path for path in (Path(f"{name}.png") for name in names) if not path.exists())
