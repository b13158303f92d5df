"""The legend: what colours and outlines mean."""

from collections.abc import Callable
from typing import NamedTuple

from marl_lanes.rendering.layout import Layout
from marl_lanes.rendering.lettering import Lettering
from marl_lanes.rendering.loading import pygame
from marl_lanes.rendering.palette import MARKING, REFUSED_GAP, ROAD, SAFE_GAP, TEXT, mix
from marl_lanes.rendering.sprites import Look, Sprites
from marl_lanes.scenario import Scenario
from marl_lanes.traffic.machine.state import Disposition

Draw = Callable[["pygame.Surface", "pygame.Rect"], None]


class Entry(NamedTuple):
    """A sign and what it means."""

    text: str
    draw: Draw


class Legend:
    """Draws the legend, with the dispositions that the scenario's traffic has.

    Args:
        scenario: of the road.
        layout: with its place.
        lettering: for the text.
    """

    def __init__(self, scenario: Scenario, layout: Layout, lettering: Lettering) -> None:
        self._layout = layout
        self._lettering = lettering
        self._sprites = Sprites(2.1 * layout.text, 0.82 * layout.text)
        self._entries = [
            self._car("commanded", Look(is_changer=True)),
            self._car("other vehicle", Look()),
            *self._dispositions(scenario),
            self._car("indicator", Look(is_changer=True, indicator=1)),
            self._car("braking", Look(is_braking=True)),
            self._car("collided or lost", Look(is_lost=True)),
            Entry("gap accepted", self._draw_accepted),
            Entry("gap refused", self._draw_refused),
            Entry("target lane", self._draw_centre),
        ]

    def draw(self, surface: "pygame.Surface") -> None:
        """Draw the signs with their texts, in two columns."""
        if "legend" not in self._layout.panel:
            return
        text, small = self._layout.text, self._layout.small
        pad = round(0.6 * text)
        rect = self._layout.panel["legend"].inflate(-2 * pad, -2 * pad)
        self._lettering.put(surface, "Legend", rect.topleft, text, TEXT, within=rect)
        per_column = -(-len(self._entries) // 2)
        top = rect.top + round(1.6 * text)
        pitch = min((rect.bottom - top) // per_column, round(2.1 * text))
        sign = pygame.Rect(0, 0, round(2.9 * text), round(1.3 * text))
        for number, entry in enumerate(self._entries):
            column, row = divmod(number, per_column)
            sign.left = rect.left + column * rect.width // 2
            sign.centery = top + row * pitch + pitch // 2
            surface.fill(ROAD, sign)
            entry.draw(surface, sign)
            left = sign.right + round(0.5 * text)
            self._lettering.put(
                surface,
                entry.text,
                (left, sign.centery),
                small,
                TEXT,
                anchor="midleft",
                within=rect,
            )

    def _dispositions(self, scenario: Scenario) -> list[Entry]:
        """Those that differ from neutral, which looks like any vehicle."""
        entries = []
        for disposition in (Disposition.COOPERATIVE, Disposition.ADVERSARIAL):
            name = disposition.name.lower()
            if scenario.followers.mix.get(name, 0.0) > 0.0:
                entries.append(self._car(name, Look(disposition=disposition)))
        if scenario.followers.external_names:
            look = Look(disposition=Disposition.EXTERNAL)
            entries.append(self._car("driven by a policy", look))
        return entries

    def _car(self, text: str, look: Look) -> Entry:
        def draw(surface: "pygame.Surface", sign: "pygame.Rect") -> None:
            picture, place = self._sprites.find(look, *sign.center, 0.0)
            surface.blit(picture, place, special_flags=pygame.BLEND_PREMULTIPLIED)

        return Entry(text, draw)

    def _draw_accepted(self, surface: "pygame.Surface", sign: "pygame.Rect") -> None:
        surface.fill(mix(ROAD, SAFE_GAP, 0.5), sign.inflate(0, -sign.height // 3))

    def _draw_refused(self, surface: "pygame.Surface", sign: "pygame.Rect") -> None:
        band = sign.inflate(0, -sign.height // 3)
        surface.fill(mix(ROAD, REFUSED_GAP, 0.2), band)
        surface.set_clip(band)
        step = max(band.height // 2, 3)
        colour = mix(ROAD, REFUSED_GAP, 0.8)
        for x in range(band.left - band.height, band.right, step):
            for left in range(x, x + max(step // 3, 2)):
                ends = (left, band.top), (left + band.height, band.bottom)
                pygame.draw.aaline(surface, colour, *ends)
        surface.set_clip(None)

    def _draw_centre(self, surface: "pygame.Surface", sign: "pygame.Rect") -> None:
        dash = max(sign.width // 7, 2)
        thickness = max(sign.height // 9, 1)
        for x in range(sign.left + dash // 2, sign.right - dash, 2 * dash):
            surface.fill(mix(ROAD, MARKING, 0.8), (x, sign.centery, dash, thickness))
