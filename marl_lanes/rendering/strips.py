"""The whole road as straight strips, in reading order."""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from marl_lanes.rendering.camera import Camera
from marl_lanes.rendering.layout import Layout, Strip
from marl_lanes.rendering.lettering import Lettering
from marl_lanes.rendering.loading import pygame
from marl_lanes.rendering.palette import GRID, MARKING, MUTED, ROAD, TEXT, mix
from marl_lanes.rendering.spotlight import Focus
from marl_lanes.rendering.sprites import Look, Sprite, Sprites
from marl_lanes.scenario import Scenario
from marl_lanes.trajectory.frames import Frame, Rows
from marl_lanes.trajectory.signals import are_commanded, are_lost

_MIN_LENGTH, _MIN_WIDTH = 3.0, 2.0
"""Least size of a vehicle [pixel]."""

_TICKS = (10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0, 5000.0, 10_000.0, 20_000.0)
"""[m] Distances between two labels."""


class Strips:
    """Draws the strips; lengths and widths have different scales.

    Args:
        scenario: of the road.
        layout: with the strips.
    """

    def __init__(self, scenario: Scenario, layout: Layout) -> None:
        self._strips = layout.strips
        self._layout = layout
        self._lanes = scenario.road.num_lanes
        self._lane_width = scenario.road.lane_width
        self._length = scenario.road.length
        if not self._strips:
            return
        first = self._strips[0]
        self._along = first.rect.width / (first.end - first.start)
        self._across = first.rect.height / (self._lanes * self._lane_width)
        self._sprites, self._large = [], []
        for body in map(scenario.body_of, scenario.drivers.profiles):
            length = max(body[0] * self._along, _MIN_LENGTH)
            width = max(body[1] * self._across, _MIN_WIDTH)
            self._sprites.append(Sprites(length, width))
            # One that drives a lane change is a bit larger, so that one finds it.
            growth = 1.0 + 0.35 * min(length, 3.0 * width)
            self._large.append(Sprites(length + growth, 1.0 + 1.35 * width))

    def draw_ground(self, surface: "pygame.Surface", lettering: Lettering) -> None:
        """Draw what stands still: lanes and positions."""
        for strip in self._strips:
            rect = strip.rect
            surface.fill(ROAD, rect)
            for lane in range(1, self._lanes):
                y = rect.bottom - round(lane * rect.height / self._lanes)
                surface.fill(mix(ROAD, MARKING, 0.22), (rect.left, y, rect.width, 1))
            for y in (rect.top - 1, rect.bottom):
                surface.fill(mix(ROAD, MARKING, 0.6), (rect.left, y, rect.width, 1))
            self._label(surface, lettering, strip)

    def draw(self, surface: "pygame.Surface", frame: Frame, focus: Focus, camera: Camera) -> None:
        """Draw the vehicles and the camera's window."""
        if not self._strips:
            return
        self._draw_vehicles(surface, frame, focus)
        for strip in self._strips:
            self._mark_window(surface, strip, camera)

    def place(self, rows: Rows) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Pixels x (right) and y (down) of the vehicles' centres; nan where there are no strips."""
        if not self._strips:
            return np.full(rows.size, np.nan), np.full(rows.size, np.nan)
        index = self._find_strips(rows["position"])
        starts = np.array([strip.start for strip in self._strips])[index]
        bottoms = np.array([strip.rect.bottom for strip in self._strips])[index]
        x = self._strips[0].rect.left + (rows["position"] - starts) * self._along
        return x, bottoms - rows["lateral_position"] * self._across

    def _find_strips(self, position: ArrayLike) -> NDArray[np.intp]:
        """Index of the strip that shows a position."""
        starts = [strip.start for strip in self._strips[1:]]
        return np.searchsorted(starts, position, side="right")

    def _label(self, surface: "pygame.Surface", lettering: Lettering, strip: Strip) -> None:
        small = self._layout.small
        widest = lettering.measure(_name(self._length), small)[0]
        step = next((step for step in _TICKS if step * self._along > 1.8 * widest), _TICKS[-1])
        first = math.ceil(strip.start / step - 1e-9)
        for number in range(first, math.floor(strip.end / step + 1e-9) + 1):
            x = strip.rect.left + (number * step - strip.start) * self._along
            surface.fill(MUTED, (round(x), strip.rect.top - 4, 1, 4))
            lettering.put(
                surface,
                _name(number * step),
                (x, strip.rect.top - 4),
                small,
                MUTED,
                anchor="midbottom",
            )

    def _draw_vehicles(self, surface: "pygame.Surface", frame: Frame, focus: Focus) -> None:
        rows = frame.rows
        ratio = self._across / self._along
        yaw = np.arctan2(np.sin(rows["yaw"]) * ratio, np.cos(rows["yaw"]))
        # One that is over the end of a strip is in two: its front is in the next one.
        rear, front = (
            self._find_strips(rows["position"] + side * rows["length"]) for side in (-0.5, 0.5)
        )
        columns = (
            *(rows["position"], rows["lateral_position"], yaw),
            *(are_commanded(rows), are_lost(rows), rows["profile"], rear, front),
        )
        layers: list[tuple[list[Sprite], list[Sprite]]] = [([], []) for _ in self._strips]
        for number, (position, lateral, angle, is_red, is_gone, profile, first, last) in enumerate(
            zip(*(column.tolist() for column in columns), strict=True)
        ):
            look = Look(is_changer=is_red, is_lost=is_gone)
            is_large = is_red or is_gone or number == focus.row
            sprites = (self._large if is_large else self._sprites)[profile]
            for index in range(first, last + 1):
                strip = self._strips[index]
                x = strip.rect.left + (position - strip.start) * self._along
                y = strip.rect.bottom - lateral * self._across
                layers[index][is_large].append(sprites.find(look, x, y, angle))
        for strip, pictures in zip(self._strips, layers, strict=True):
            surface.set_clip((strip.rect.left, 0, strip.rect.width, surface.get_height()))
            for layer in pictures:
                surface.fblits(layer, pygame.BLEND_PREMULTIPLIED)
        surface.set_clip(None)
        if focus.row is not None:
            strip = self._strips[int(self._find_strips(rows["position"][focus.row]))]
            x = self.place(rows)[0][focus.row]
            self._point_at(surface, x, strip.rect.bottom)

    def _point_at(self, surface: "pygame.Surface", x: float, bottom: int) -> None:
        """A triangle below the strip, at the followed vehicle."""
        size = max(round(0.35 * self._layout.text), 3)
        top = bottom + 2
        pygame.draw.polygon(
            surface, TEXT, [(x, top), (x - size, top + size), (x + size, top + size)]
        )

    def _mark_window(self, surface: "pygame.Surface", strip: Strip, camera: Camera) -> None:
        start, end = max(camera.start, strip.start), min(camera.end, strip.end)
        if start >= end:
            return
        x = strip.rect.left + round((start - strip.start) * self._along)
        width = max(round((end - start) * self._along), 2)
        window = pygame.Rect(x, strip.rect.top - 2, width, strip.rect.height + 4)
        pygame.draw.rect(surface, mix(GRID, MARKING, 0.55), window, 1)


def _name(position: float) -> str:
    """A position in metres, or in kilometres where these are shorter."""
    if position >= 10_000.0 and position % 100.0 == 0.0:
        return f"{position / 1000.0:g} km"
    return f"{position:.0f} m"
