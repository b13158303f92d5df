"""Where the parts of a picture are, for every size."""

from dataclasses import dataclass

from marl_lanes.rendering.camera import MARGIN
from marl_lanes.rendering.loading import pygame
from marl_lanes.rendering.options import ViewOptions
from marl_lanes.scenario import Scenario

COLUMNS = {"time": 15, "agent": 23, "reward": 24, "legend": 27}
"""Parts of the panel and their widths, in lines of text; the first come first."""

PANEL_LINES = 10
"""Height of a part of the panel, in lines of its spacing."""

SPACING = 1.45
"""Distance of two lines of text, in their size."""

_MIN_TEXT, _TEXT_SHARE, _MAX_TEXT = 10, 1.0 / 51.0, 44
"""Size of text: limits [pixel], and the share of the height."""


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
    margin = text
    road_width = road.num_lanes * road.lane_width
    needed = round((road_width + 4.0 * MARGIN) * width / options.span)
    camera_height = min(max(needed, round(0.30 * height)), round(0.55 * height))
    panel, panel_height = _place_panel(width, height - camera_height, text)
    rest = height - camera_height - panel_height
    strips = _place_strips(scenario, width, min(rest, round(0.30 * height)), text)
    strips_height = (strips[-1].rect.bottom + margin // 2) if strips else 0
    if not panel and not strips:
        camera_height = height
    else:
        camera_height = height - panel_height - strips_height
    return Layout(
        options.size,
        text,
        pygame.Rect(0, 0, width, camera_height),
        tuple(Strip(strip.rect.move(0, camera_height), strip.start, strip.end) for strip in strips),
        {name: rect.move(0, height - panel_height) for name, rect in panel.items()},
    )


def _place_panel(width: int, free: int, text: int) -> tuple[dict[str, "pygame.Rect"], int]:
    """Parts side by side, those that fit, and the height of all; the top is 0."""
    margin = round(0.7 * text)
    height = round(PANEL_LINES * SPACING * text) + margin
    strip = round(5.0 * text)
    if height + strip + margin > free:
        return {}, 0
    names: list[str] = []
    left = margin
    for name, lines in COLUMNS.items():
        if left + lines * text + margin > width:
            break
        names.append(name)
        left += lines * text + margin
    if len(names) < 2:
        return {}, 0
    # The rest of the width goes to all in proportion.
    share = (width - margin * (len(names) + 1)) / sum(COLUMNS[name] for name in names)
    rects, left = {}, float(margin)
    for name in names:
        rects[name] = pygame.Rect(round(left), 0, int(share * COLUMNS[name]), height)
        left += share * COLUMNS[name] + margin
    return rects, height + margin


def _place_strips(scenario: Scenario, width: int, free: int, text: int) -> list[Strip]:
    """The whole road in rows; the top of all is 0."""
    road = scenario.road
    margin = text
    lane = min(max(round(0.5 * text), 4), max(3, round(6.0 * text / road.num_lanes)))
    label = round(1.5 * text)
    row = road.num_lanes * lane + label
    length = width - 2 * margin
    # At the scale of two pixels a metre a vehicle is a rectangle that one sees.
    wanted = max(1, -(-2.0 * road.length // length))
    count = int(min(wanted, (free - margin // 2) // row))
    if count < 1:
        return []
    piece = road.length / count
    return [
        Strip(
            pygame.Rect(margin, index * row + label, length, road.num_lanes * lane),
            index * piece,
            (index + 1) * piece,
        )
        for index in range(count)
    ]
