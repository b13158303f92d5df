"""The picture of one time step."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from marl_lanes.rendering.camera import Camera
from marl_lanes.rendering.layout import make_layout
from marl_lanes.rendering.legend import Legend
from marl_lanes.rendering.lettering import Lettering
from marl_lanes.rendering.loading import pygame
from marl_lanes.rendering.options import ViewOptions
from marl_lanes.rendering.palette import BACKGROUND
from marl_lanes.rendering.panel import Panel
from marl_lanes.rendering.scene import Scene
from marl_lanes.rendering.spotlight import Spotlight
from marl_lanes.rendering.strips import Strips
from marl_lanes.scenario import Scenario
from marl_lanes.trajectory.frames import Frame

Picture = NDArray[np.uint8]
"""(height, width, 3), red, green and blue."""

_REACH = 8.0
"""[pixel] From a vehicle's centre, at least, where it is found."""


class Painter:
    """Draws the frames of a road, one after the other.

    It needs no display. It remembers whom it follows and what has just happened; a frame of another
    road, or an earlier one, makes it forget. The same frames give the same bytes.

    Args:
        scenario: of the road.
        options: of the view; a mapping may leave fields out.
        title: for the panel, for example the policy's name.

    Raises:
        ValueError: an option is not valid.
    """

    def __init__(
        self,
        scenario: Scenario,
        options: ViewOptions | Mapping[str, Any] | None = None,
        *,
        title: str = "",
    ) -> None:
        self.options = ViewOptions.make(options)
        self.layout = make_layout(scenario, self.options)
        self.lettering = Lettering()
        self.camera = Camera(scenario, self.layout.camera.size, self.options.span)
        self._spotlight = Spotlight(self.options)
        self._scene = Scene(scenario, self.layout, self.camera, self.lettering)
        self._strips = Strips(scenario, self.layout)
        self._panel = Panel(scenario, self.layout, self.lettering, title, self.options.speed)
        self._legend = Legend(scenario, self.layout, self.lettering)
        self._surface = pygame.Surface(self.options.size, depth=32)
        self._ground = self._draw_ground()
        top = self.layout.camera.bottom
        # The camera's view is drawn anew as a whole.
        self._below = pygame.Rect(0, top, self.options.size[0], self.options.size[1] - top)

    def note(self, frame: Frame) -> None:
        """Remember what happens in a frame that is not drawn, for the next ones that are."""
        self._spotlight.look(frame)

    def draw(self, frame: Frame) -> Picture:
        """The picture of a frame, (height, width, 3) uint8."""
        focus = self._spotlight.look(frame)
        incidents = self._spotlight.incidents
        self.camera.look_at(focus.position)
        self.lettering.begin()
        self._surface.blit(self._ground, self._below.topleft, self._below)
        self._panel.draw(self._surface, frame, focus, incidents)
        self._strips.draw(self._surface, frame, focus, self.camera)
        self._scene.draw(self._surface, frame, focus, incidents)
        return self._read()

    @property
    def followed(self) -> int:
        """Number of the vehicle that the last picture followed; -1 if there was none."""
        return self._spotlight.followed

    def follow(self, vehicle: int | None) -> None:
        """Follow a vehicle from the next picture on; None: the picture chooses."""
        self._spotlight.follow(vehicle)

    def forget(self) -> None:
        """Begin anew: forget whom the pictures followed, and what has happened."""
        self._spotlight.forget()

    def find_vehicle(self, frame: Frame, place: tuple[int, int]) -> int | None:
        """The vehicle at a place of a picture, in the camera's view or in a strip.

        Args:
            frame: the one that was drawn last.
            place: x to the right and y down [pixel].

        Returns:
            its number; None where there is no vehicle.
        """
        rows, view = frame.rows, self.layout.camera
        reach = np.full(rows.size, _REACH)
        if view.collidepoint(place):
            x, y, _ = self.camera.place(rows["position"], rows["lateral_position"])
            x, y = x + view.left, y + view.top
            reach = np.maximum(0.5 * rows["length"] * self.camera.scale, reach)
        else:
            x, y = self._strips.place(rows)
        distance = np.hypot(x - place[0], y - place[1])
        found = np.flatnonzero(distance <= reach)
        return int(rows["vehicle"][found[np.argmin(distance[found])]]) if found.size else None

    def _draw_ground(self) -> "pygame.Surface":
        """What stands still in all frames."""
        ground = pygame.Surface(self.options.size, depth=32)
        ground.fill(BACKGROUND)
        self._panel.draw_ground(ground)
        self._legend.draw(ground)
        self._strips.draw_ground(ground, self.lettering)
        self.lettering.fix()
        return ground

    def _read(self) -> Picture:
        width, height = self.options.size
        picture = np.empty((height, width, 3), np.uint8)
        # A surface over the array's memory: pygame drops the fourth byte faster than numpy.
        target = pygame.image.frombuffer(picture.data.cast("B"), (width, height), "RGB")
        target.blit(self._surface, (0, 0))
        return picture
