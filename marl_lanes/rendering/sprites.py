"""Pictures of vehicles, drawn once for each look, angle and fraction of a pixel."""

import math
from typing import NamedTuple

from marl_lanes.rendering.loading import pygame
from marl_lanes.rendering.palette import (
    BRAKE_LIGHT,
    CHANGER,
    INDICATOR,
    MARKING,
    VEHICLE,
    Colour,
    outline_of,
)
from marl_lanes.traffic.machine.state import Disposition

ANGLE_STEP = 0.5
"""[degree] Between the angles of the pictures."""

PHASES = 4
"""Pictures for each pixel in both directions, so that slow motion does not jump."""

_MAX_KEPT = 8192
"""Pictures; beyond that all are drawn anew."""

_MIN_OUTLINED, _MIN_PATTERNED = 5.0, 7.0
"""[pixel] Least widths of vehicles with outlines and windows, and with patterned outlines."""

_MIN_TRUCK = 4.0
"""[1] Length by width from which a body is drawn as a tractor with a trailer."""

_BLACK = (12, 14, 17)
_GLASS = (38, 46, 58)
_HEADLIGHT = (255, 250, 225)


Sprite = tuple["pygame.Surface", tuple[int, int]]
"""A picture, its colours multiplied by alpha, and where its top left corner goes."""


class Look(NamedTuple):
    """What a vehicle looks like."""

    is_changer: bool = False
    disposition: Disposition = Disposition.NEUTRAL
    is_braking: bool = False
    indicator: int = 0
    """1: the left one is lit, -1: the right one, 0: none."""
    is_lost: bool = False
    """It collided, or left the road, in this step."""


class Sprites:
    """Vehicles of one size, smooth at every angle and position.

    Args:
        length: of a vehicle [pixel].
        width: of a vehicle [pixel].
    """

    def __init__(self, length: float, width: float) -> None:
        self.length = length
        self.width = width
        self._factor = PHASES * min(max(math.ceil(12.0 / width), 1), 3)
        self._flat: dict[Look, pygame.Surface] = {}
        self._turned: dict[tuple[Look, int, int, int], tuple[pygame.Surface, int, int]] = {}

    def find(self, look: Look, x: float, y: float, angle: float) -> Sprite:
        """The picture of a vehicle at a place.

        Args:
            look: of the vehicle.
            x: of the middle [pixel].
            y: of the middle, down [pixel].
            angle: of the heading, counterclockwise from the right [rad].
        """
        column, row = round(x * PHASES), round(y * PHASES)
        turn = round(math.degrees(angle) / ANGLE_STEP)
        key = (look, turn, column % PHASES, row % PHASES)
        found = self._turned.get(key)
        if found is None:
            if len(self._turned) >= _MAX_KEPT:
                self._turned.clear()
            found = self._turned[key] = self._turn(*key)
        picture, left, top = found
        return picture, (column // PHASES - left, row // PHASES - top)

    def _turn(
        self, look: Look, turn: int, column: int, row: int
    ) -> tuple["pygame.Surface", int, int]:
        """The picture at an angle, its middle at a fraction of a pixel."""
        if look not in self._flat:
            self._flat[look] = self._draw(look)
        factor = self._factor
        turned = pygame.transform.rotate(self._flat[look], turn * ANGLE_STEP)
        width, height = (size / factor for size in turned.get_size())
        left, top = math.ceil(0.5 * width) + 1, math.ceil(0.5 * height) + 1
        canvas = pygame.Surface((2 * left * factor, 2 * top * factor), pygame.SRCALPHA)
        x = (left + column / PHASES - 0.5 * width) * factor
        y = (top + row / PHASES - 0.5 * height) * factor
        canvas.blit(turned, (round(x), round(y)), special_flags=pygame.BLEND_PREMULTIPLIED)
        return pygame.transform.smoothscale(canvas, (2 * left, 2 * top)), left, top

    def _draw(self, look: Look) -> "pygame.Surface":
        """The vehicle heading to the right, enlarged."""
        factor = self._factor
        length, width = self.length * factor, self.width * factor
        # The indicators and the cross reach beyond the body.
        margin = max(0.3 * width, 2.0 * factor)
        size = (math.ceil(length + 2.0 * margin), math.ceil(width + 2.0 * margin))
        surface = pygame.Surface(size, pygame.SRCALPHA)
        body = pygame.Rect(0, 0, round(length), round(width))
        body.center = (size[0] // 2, size[1] // 2)
        thickness = self._draw_body(surface, body, look)
        inner = body.inflate(-2 * thickness, -2 * thickness)
        if self.length > _MIN_TRUCK * self.width:
            _draw_cab(surface, inner)
        elif self.width >= _MIN_OUTLINED and self.length > 1.5 * self.width:
            _draw_windows(surface, inner)
        if look.is_braking:
            _draw_brake_lights(surface, body)
        if look.indicator:
            _draw_indicator(surface, body, look.indicator, max(0.22 * width, 1.5 * factor))
        if look.is_lost:
            _draw_cross(surface, body, factor)
        return surface.premul_alpha()

    def _draw_body(self, surface: "pygame.Surface", body: "pygame.Rect", look: Look) -> int:
        """Body with outline; returns the outline's thickness, enlarged."""
        colour = CHANGER if look.is_changer else VEHICLE
        outline = outline_of(look.disposition)
        is_plain = look.disposition == Disposition.NEUTRAL
        # In smaller vehicles the outline's colour would mix with the body's.
        thin = 0.07 * self.width if is_plain else max(0.15 * self.width, 1.2)
        thickness = round(thin * self._factor) if self.width >= _MIN_OUTLINED else 0
        radius = round(0.22 * body.height)
        # In smaller vehicles a pattern is no pattern any more.
        is_patterned = self.width >= _MIN_PATTERNED
        is_dashed = is_patterned and look.disposition == Disposition.ADVERSARIAL
        pygame.draw.rect(surface, _BLACK if is_dashed else outline, body, border_radius=radius)
        if is_dashed:
            _draw_dashes(surface, body, outline, radius)
        inner = body.inflate(-2 * thickness, -2 * thickness)
        if is_patterned and look.disposition == Disposition.EXTERNAL:
            # A double line.
            middle = body.inflate(-thickness, -thickness)
            pygame.draw.rect(surface, _BLACK, middle, border_radius=radius - thickness // 2)
        pygame.draw.rect(surface, colour, inner, border_radius=max(radius - thickness, 0))
        return thickness


def _draw_dashes(
    surface: "pygame.Surface", body: "pygame.Rect", colour: Colour, radius: int
) -> None:
    """Five pieces along the long sides, three along the short ones, on the dark outline."""
    mask = pygame.Surface(body.size, pygame.SRCALPHA)
    pygame.draw.rect(mask, colour, mask.get_rect(), border_radius=radius)
    step = body.width / 9.0
    for piece in range(1, 9, 2):
        mask.fill((0, 0, 0, 0), (round(piece * step), 0, round(step * 0.8), body.height))
    surface.blit(mask, body.topleft)


def _draw_cab(surface: "pygame.Surface", body: "pygame.Rect") -> None:
    """The joint between tractor and trailer, and a windscreen at the front; none behind."""
    width = body.height
    for front, length in ((1.0, 0.22), (0.22, 0.18)):
        left = round(body.right - (front + length) * width)
        surface.fill(_GLASS, (left, body.top, max(round(length * width), 1), width))


def _draw_windows(surface: "pygame.Surface", body: "pygame.Rect") -> None:
    """Windscreen and rear window: the wide one is in front."""
    left, top, length, width = body
    for back, front, narrow_back, narrow_front in (
        (0.57, 0.76, 0.25, 0.18),
        (0.13, 0.21, 0.20, 0.25),
    ):
        pygame.draw.polygon(
            surface,
            _GLASS,
            [
                (left + back * length, top + narrow_back * width),
                (left + front * length, top + narrow_front * width),
                (left + front * length, top + (1.0 - narrow_front) * width),
                (left + back * length, top + (1.0 - narrow_back) * width),
            ],
        )
    for side in (0.06, 0.80):
        lamp = pygame.Rect(0, 0, round(0.05 * length), round(0.14 * width))
        lamp.midright = (left + length, round(top + (side + 0.07) * width))
        pygame.draw.rect(surface, _HEADLIGHT, lamp)


def _draw_brake_lights(surface: "pygame.Surface", body: "pygame.Rect") -> None:
    length = round(0.26 * body.height)
    bar = pygame.Rect(body.left, body.top, length, round(0.36 * body.height))
    for top in (body.top, body.bottom - bar.height):
        bar.top = top
        pygame.draw.rect(surface, BRAKE_LIGHT, bar, border_radius=round(0.1 * body.height))


def _draw_indicator(surface: "pygame.Surface", body: "pygame.Rect", side: int, size: float) -> None:
    """Lamps at the front and rear corner of one side, which reach over the body's edge."""
    y = body.top if side > 0 else body.bottom - 1
    for x in (body.left + 0.10 * body.width, body.right - 0.10 * body.width):
        lamp = pygame.Rect(0, 0, round(2.0 * size), round(1.5 * size))
        lamp.center = (round(x), y)
        pygame.draw.rect(surface, INDICATOR, lamp, border_radius=round(0.5 * size))


def _draw_cross(surface: "pygame.Surface", body: "pygame.Rect", factor: int) -> None:
    reach = body.inflate(round(0.4 * body.height), round(0.4 * body.height))
    for colour, thickness in ((_BLACK, 0.30), (MARKING, 0.16)):
        width = max(round(thickness * body.height), factor)
        pygame.draw.line(surface, colour, reach.topleft, reach.bottomright, width)
        pygame.draw.line(surface, colour, reach.bottomleft, reach.topright, width)
