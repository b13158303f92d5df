"""The picture of one time step."""

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


class Painter:
    """Draws the frames of a road, one after the other.

    It needs no display. It remembers whom it follows and what has just happened; a frame of another
    road, or an earlier one, makes it forget. The same frames give the same bytes.

    Args:
        scenario: of the road.
        options: of the view.
        title: for the panel, for example the policy's name.

    Raises:
        MissingExtraError: pygame is not installed.
    """

    def __init__(
        self, scenario: Scenario, options: ViewOptions | None = None, *, title: str = ""
    ) -> None:
        self.options = options if options is not None else ViewOptions()
        self.layout = make_layout(scenario, self.options)
        self.lettering = Lettering()
        self._camera = Camera(scenario, self.layout.camera.size, self.options.span)
        self._spotlight = Spotlight(self.options)
        self._scene = Scene(scenario, self.layout, self._camera, self.lettering)
        self._strips = Strips(scenario, self.layout)
        self._panel = Panel(scenario, self.layout, self.lettering, title, self.options.speed)
        self._legend = Legend(scenario, self.layout, self.lettering)
        self._surface = pygame.Surface(self.options.size, depth=32)
        self._ground = self._draw_ground()

    def draw(self, frame: Frame) -> Picture:
        """The picture of a frame, (height, width, 3) uint8."""
        focus = self._spotlight.look(frame)
        incidents = self._spotlight.incidents
        self._camera.look_at(focus.position)
        self.lettering.begin()
        self._surface.blit(self._ground, (0, 0))
        self._panel.draw(self._surface, frame, focus, incidents)
        self._strips.draw(self._surface, frame, focus, self._camera)
        self._scene.draw(self._surface, frame, focus, incidents)
        return self._read()

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
        packed = pygame.surfarray.pixels2d(self._surface).T
        channels = packed.view(np.uint8).reshape(height, width, 4)
        picture = np.empty((height, width, 3), np.uint8)
        for index in range(3):
            picture[:, :, index] = channels[:, :, 2 - index]
        return picture
