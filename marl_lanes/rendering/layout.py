"""Where the parts of a picture are, for every size."""

import math
from dataclasses import dataclass

from marl_lanes.rendering.loading import pygame
from marl_lanes.rendering.options import ViewOptions
from marl_lanes.scenario import Scenario

COLUMNS = {"time": 13, "agent": 22, "reward": 22, "legend": 26}
"""Parts of the panel and their widths, in lines of text; the first come first."""

PANEL_LINES = 10
"""Height of a part of the panel, in lines of its spacing."""

SPACING = 1.45
"""Distance of two lines of text, in their size."""

_MIN_TEXT, _TEXT_SHARE, _MAX_TEXT = 11, 1.0 / 51.0, 44
"""Size of text: limits [pixel], and the share of the height."""


_VERGE, _CURVED_VERGE = 8.0, 12.0
"""[m] Of ground beside the road that the camera's view shows, if there is room."""

_STRIP_SCALE = 0.185
"""[1/m] Pixels for each metre, in the size of text, that make a vehicle in a strip a rectangle."""

_MAX_STRIPS = 6

_STRIPS_SHARE = 0.25
"""Of the height, at most."""

_MIN_LINES = 22
"""Lines of text in the height of a picture that has more than the camera's view."""

_STRIP_LINES = 5
"""Lines of text that the panel leaves for a strip."""

_MIN_LANE = 4
"""[pixel] Least width of a lane in a strip."""


@dataclass(frozen=True)
class Strip:
    """A piece of the whole road."""

    rect: "pygame.Rect"
    """Of its lanes."""
    start: float
    end: float
    """Positions [m]."""


@dataclass(frozen=True)
class Layout:
    """The parts of a picture; they are disjoint.

    Attributes:
        text: size of a line of text [pixel].
        camera: view of the road to scale.
        strips: the whole road; may be empty.
        panel: part of each name of COLUMNS that has a place.
    """

    size: tuple[int, int]
    text: int
    camera: "pygame.Rect"
    strips: tuple[Strip, ...]
    panel: dict[str, "pygame.Rect"]

    @property
    def small(self) -> int:
        """Size of minor text [pixel]."""
        return max(round(0.85 * self.text), _MIN_TEXT)

    @property
    def line(self) -> int:
        """Distance of two lines of text [pixel]."""
        return round(SPACING * self.text)


def make_layout(scenario: Scenario, options: ViewOptions) -> Layout:
    """The layout: the camera always, then strips, then as many parts of the panel as fit."""
    width, height = options.size
    text = round(min(max(min(width * 9.0 / 16.0, height) * _TEXT_SHARE, _MIN_TEXT), _MAX_TEXT))
    road = scenario.road
    verge = _CURVED_VERGE if road.arcs else _VERGE
    wanted = (road.num_lanes * road.lane_width + 2.0 * verge) * width / options.span
    least = round(min(max(wanted, 0.30 * height), 0.55 * height))
    panel, panel_height = _place_panel(width, height - least, text)
    free = min(height - least - panel_height, round(_STRIPS_SHARE * height))
    if height < _MIN_LINES * text:
        free = 0
    strips, strips_height = _place_strips(scenario, width, free, text)
    camera = pygame.Rect(0, 0, width, height - panel_height - strips_height)
    return Layout(
        options.size,
        text,
        camera,
        tuple(Strip(strip.rect.move(0, camera.bottom), strip.start, strip.end) for strip in strips),
        {name: rect.move(0, height - panel_height) for name, rect in panel.items()},
    )


def _place_panel(width: int, free: int, text: int) -> tuple[dict[str, "pygame.Rect"], int]:
    """Parts side by side, in as many rows as there is room for, and the height of all.

    The top is 0. No panel is better than the time alone.
    """
    margin = round(0.7 * text)
    # The last line needs its letters' height alone; above and below there is an edge.
    height = (
        (PANEL_LINES - 1) * round(SPACING * text) + math.ceil(1.15 * text) + 2 * round(0.6 * text)
    )
    rows: list[list[str]] = [[]]
    for name, lines in COLUMNS.items():
        used = sum(COLUMNS[other] * text + margin for other in rows[-1])
        if margin + used + lines * text + margin > width:
            rows.append([])
        rows[-1].append(name)
    num_rows = min(len(rows), (free - _STRIP_LINES * text) // (height + margin))
    if num_rows < 1 or len(rows[0]) < 2:
        return {}, 0
    rects = {}
    for index, names in enumerate(rows[:num_rows]):
        # The rest of the width goes to all in proportion.
        share = (width - margin * (len(names) + 1)) / sum(COLUMNS[name] for name in names)
        left = float(margin)
        for name in names:
            top = index * (height + margin)
            rects[name] = pygame.Rect(round(left), top, int(share * COLUMNS[name]), height)
            left += share * COLUMNS[name] + margin
    return rects, num_rows * (height + margin)


def _place_strips(scenario: Scenario, width: int, free: int, text: int) -> tuple[list[Strip], int]:
    """The whole road in rows, and the height of all; the top is 0."""
    road = scenario.road
    length = width - 2 * text
    label = round(1.7 * text)
    least = label + _MIN_LANE * road.num_lanes
    wanted = math.ceil(_STRIP_SCALE * text * road.length / length)
    count = min(wanted, _MAX_STRIPS, (free - text // 2) // least)
    if count < 1:
        return [], 0
    lane = ((free - text // 2) // count - label) // road.num_lanes
    lane = min(lane, max(round(0.75 * text), _MIN_LANE))
    piece, row = road.length / count, label + road.num_lanes * lane
    strips = [
        Strip(
            pygame.Rect(text, index * row + label, length, road.num_lanes * lane),
            index * piece,
            (index + 1) * piece,
        )
        for index in range(count)
    ]
    return strips, count * row + text // 2
