"""What ``render_mode`` shows: pictures of a road of an environment, as arrays or in a window."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from marl_lanes.rendering.options import ViewOptions
from marl_lanes.rendering.painter import Painter
from marl_lanes.rendering.window import Window
from marl_lanes.traffic.simulator import Simulator
from marl_lanes.trajectory.frames import FrameReader

View = ViewOptions | Mapping[str, Any] | None
"""How a road is shown; None: the defaults."""


class Renderer:
    """Pictures of one road of a simulator; it reads the road and never steps it.

    Its owner calls ``note`` before every step and ``restart`` after every reset.

    Args:
        simulator: owns the road.
        road: its index within the simulator.
        view: how it is shown.
        has_window: whether ``show`` shows the pictures in a window.

    Raises:
        MissingExtraError: pygame is not installed.
        ValueError: ``view`` is not valid.
    """

    def __init__(
        self, simulator: Simulator, road: int, view: View, *, has_window: bool = False
    ) -> None:
        self._simulator = simulator
        self._options = ViewOptions.make(view)
        self._reader = FrameReader(simulator, [road])
        self._painter: Painter | None = None
        self._picture: NDArray[np.uint8] | None = None
        self._has_window = has_window
        self._window: Window | None = None

    def note(self) -> None:
        """Remember what the next step may remove; the picture is then out of date."""
        self._picture = None
        self._reader.note()

    def restart(self) -> None:
        """Forget everything of the time before a reset."""
        if self._painter is not None:
            self._painter.forget()
        self.note()

    def render(self) -> NDArray[np.uint8]:
        """The picture of the present state, (H, W, 3); the same bytes until the next step."""
        if self._picture is None:
            (frame,) = self._reader.read_frames()
            self._picture = self._find_painter().draw(frame)
        return self._picture.copy()

    def open(self) -> None:
        """Open the window, if there shall be one and there was none before.

        Raises:
            DisplayError: there is no display.
        """
        if self._has_window and self._window is None:
            self._window = Window(self._simulator.scenario, self._options)

    @property
    def is_open(self) -> bool:
        """Whether a window shows the road."""
        return self._window is not None and self._window.is_open

    def show(self) -> None:
        """Show the present state, if a window is open, and wait until the next step is due."""
        if self._window is not None and self._window.is_open:
            (frame,) = self._reader.read_frames()
            self._window.show(self._find_painter(), frame)

    def attend(self) -> None:
        """Do what the window's user has asked for since the last step."""
        if self._window is not None:
            self._window.attend()

    def close(self) -> None:
        """Close the window for good."""
        self._has_window = False
        if self._window is not None:
            self._window.close()

    def _find_painter(self) -> Painter:
        if self._painter is None:
            self._painter = Painter(self._simulator.scenario, self._options)
        return self._painter

    def __getstate__(self) -> dict[str, Any]:
        # Neither can be copied. If there was a window, the copy goes on as if it had been closed.
        has_window = self._has_window and self._window is None
        return {**self.__dict__, "_painter": None, "_window": None, "_has_window": has_window}
