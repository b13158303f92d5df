"""The panel: time, the followed agent, its reward."""

import math

import numpy as np

from marl_lanes.rendering.layout import Layout
from marl_lanes.rendering.lettering import Lettering
from marl_lanes.rendering.loading import pygame
from marl_lanes.rendering.palette import (
    BACKGROUND,
    GRID,
    MUTED,
    OUTCOMES,
    PANEL,
    PHASES,
    SAFE_GAP,
    TEXT,
    WARNING,
    Colour,
)
from marl_lanes.rendering.spotlight import Focus, Incident
from marl_lanes.scenario import Scenario
from marl_lanes.traffic.machine.state import NONE, Phase
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.trajectory.columns import COLUMNS
from marl_lanes.trajectory.frames import Frame, Rows
from marl_lanes.trajectory.signals import are_commanded

_LEAST_REWARD, _DECADES = 1e-3, 4
"""A bar of a reward is log10(1 + |r|/_LEAST_REWARD)/_DECADES long."""


class Panel:
    """Draws the parts of the panel that the layout has a place for.

    Args:
        scenario: of the road.
        layout: with the places.
        lettering: for the text.
        title: of the picture, for example the policy's name.
        speed: of playback [1].
    """

    def __init__(
        self, scenario: Scenario, layout: Layout, lettering: Lettering, title: str, speed: float
    ) -> None:
        self._scenario = scenario
        self._layout = layout
        self._lettering = lettering
        self._title = title
        self._speed = speed
        (names,) = (column.names for column in COLUMNS if column.name == "disposition")
        self._dispositions = () if names is None else names(scenario)
        weights = CHANGER.weights(scenario)
        is_used = [
            weight > 0.0 and (term.name != "longitudinal" or scenario.action.longitudinal)
            for term, weight in zip(CHANGER.terms, weights, strict=True)
        ]
        self._terms = [
            name for name, is_there in zip(CHANGER.reward_names, is_used, strict=True) if is_there
        ]

    def draw_ground(self, surface: "pygame.Surface") -> None:
        """Draw the boxes."""
        for rect in self._layout.panel.values():
            pygame.draw.rect(surface, PANEL, rect, border_radius=self._layout.text // 2)

    def draw(
        self, surface: "pygame.Surface", frame: Frame, focus: Focus, incidents: list[Incident]
    ) -> None:
        """Draw the text of one time step."""
        for name, rect in self._layout.panel.items():
            part = _Part(self._layout, self._lettering, surface, rect)
            if name == "time":
                self._draw_time(part, frame)
            elif name == "agent":
                self._draw_agent(part, frame, focus, incidents)
            elif name == "reward":
                self._draw_reward(part, frame, focus)

    def _draw_time(self, part: "_Part", frame: Frame) -> None:
        part.write(f"{frame.time:.1f} s", TEXT, scale=2)
        rows = frame.rows
        if self._title:
            part.write(self._title, TEXT)
        part.write(self._scenario.name, TEXT)
        part.write(f"road {frame.road}", MUTED)
        part.write(f"{rows.size} vehicles", MUTED)
        part.write(f"{int(are_commanded(rows).sum())} commanded", MUTED)
        if self._speed != 1.0:
            part.write(f"{self._speed:g} x speed", MUTED)

    def _draw_agent(
        self, part: "_Part", frame: Frame, focus: Focus, incidents: list[Incident]
    ) -> None:
        ended = [one for one in incidents if one.vehicle == focus.vehicle and one.command != NONE]
        row = None if focus.row is None else frame.rows[focus.row]
        if row is not None and row["phase"] != Phase.ABSENT:
            phase = Phase(int(row["phase"]))
            part.write(f"changer_{row['command']}", TEXT, chip=(phase.name.lower(), PHASES[phase]))
        elif ended:
            outcome = ended[-1].outcome
            chip = outcome.name.lower().replace("_", " "), OUTCOMES[outcome]
            part.write(f"changer_{ended[-1].command}", TEXT, chip=chip)
        else:
            is_live = (frame.rows["phase"] != Phase.ABSENT).any()
            part.write("Not commanded" if is_live else "No command is live", TEXT)
        if row is None:
            part.write("the followed vehicle is gone", MUTED)
        else:
            self._describe(part, frame.rows, row)

    def _describe(self, part: "_Part", rows: Rows, row: np.void) -> None:
        is_live = row["phase"] != Phase.ABSENT
        if is_live:
            side = "left" if row["direction"] > 0 else "right"
            part.pair(f"to the {side}", f"lane {row['origin_lane']} to {row['target_lane']}")
        else:
            part.pair("vehicle", f"{row['vehicle']}")
        part.pair("speed", f"{row['speed']:.1f} m/s, {3.6 * row['speed']:.0f} km/h")
        part.pair("acceleration", _signed(row["acceleration"], 1, "m/s²"))
        if not is_live:
            part.pair("lane", f"{row['lane']}")
            part.pair("disposition", self._dispositions[row["disposition"]])
            return
        part.pair("gap ahead", self._gap(rows, row, "target_leader"))
        part.pair("gap behind", self._gap(rows, row, "target_follower"))
        part.pair("deviation", _signed(row["lateral_deviation"], 2, "m"))
        part.pair("yaw", _signed(math.degrees(row["direction"] * row["yaw"]), 1, "°"))
        names = ("action_yaw_acceleration", "action_acceleration")
        for name, dimension in zip(names, CHANGER.act(self._scenario), strict=False):
            value = float(row[name])
            label = {"yaw_acceleration": "steering"}.get(dimension.name, "throttle")
            number = _signed(value, 2, dimension.unit.replace("^2", "²"))
            part.bar(label, number, value / max(-dimension.low, dimension.high), SAFE_GAP)

    def _gap(self, rows: Rows, row: np.void, name: str) -> str:
        """Bumper to bumper."""
        found = np.flatnonzero(rows["vehicle"] == row[name])
        if row[name] == NONE or not found.size:
            return "free"
        other = rows[found[0]]
        distance = abs(float(other["position"]) - float(row["position"]))
        return f"{distance - 0.5 * (row['length'] + other['length']):.1f} m"

    def _draw_reward(self, part: "_Part", frame: Frame, focus: Focus) -> None:
        part.write("Reward of the step", TEXT)
        if focus.row is None or np.isnan(frame.rows["reward"][focus.row]):
            part.write("none without a command", MUTED)
            return
        row = frame.rows[focus.row]
        for name in (*self._terms, "reward"):
            value = float(row[name])
            length = math.log10(1.0 + abs(value) / _LEAST_REWARD) / _DECADES
            label = name.removeprefix("reward_").replace("_", " ") if name != "reward" else "sum"
            colour = SAFE_GAP if value > 0.0 else WARNING
            part.bar(label, _signed(value, 3), math.copysign(min(length, 1.0), value), colour)
        part.write("bars: logarithmic, 0.001 to 10", MUTED, is_small=True)


class _Part:
    """A part of the panel that is filled line by line; what does not fit is left out."""

    def __init__(
        self,
        layout: Layout,
        lettering: Lettering,
        surface: "pygame.Surface",
        rect: "pygame.Rect",
    ) -> None:
        self._layout = layout
        self._lettering = lettering
        self._surface = surface
        pad = round(0.6 * layout.text)
        self._rect = rect.inflate(-2 * pad, -2 * pad)
        self._top = self._rect.top

    def write(
        self,
        text: str,
        colour: Colour,
        *,
        scale: int = 1,
        is_small: bool = False,
        chip: tuple[str, Colour] | None = None,
    ) -> None:
        """A line of text, at its right end a word in a box of a colour."""
        size = self._layout.small if is_small else scale * self._layout.text
        put, rect, width = self._lettering.put, self._rect, self._rect.width
        if chip is not None:
            word, fill = chip
            right = rect.right, self._top - round(0.1 * size)
            box = put(self._surface, word, right, size, BACKGROUND, anchor="topright", chip=fill)
            width -= box.width if box is not None else 0
        shown = self._lettering.shorten(text, size, width)
        put(self._surface, shown, (rect.left, self._top), size, colour, within=rect)
        self._top += round(scale * self._layout.line * (1.0 if scale == 1 else 0.9))

    def pair(self, name: str, value: str) -> None:
        """A line with a name and a value."""
        put, rect, text = self._lettering.put, self._rect, self._layout.text
        put(self._surface, name, (rect.left, self._top), text, MUTED, within=rect)
        right = rect.right, self._top
        put(self._surface, value, right, text, TEXT, anchor="topright", within=rect)
        self._top += self._layout.line

    def bar(self, name: str, value: str, share: float, colour: Colour) -> None:
        """A line with a name, a bar to the left or right of its middle, and a value.

        Args:
            name: on the left.
            value: on the right.
            share: of the half bar, -1 to 1; nan for no bar.
            colour: of the bar.
        """
        rect, text, surface = self._rect, self._layout.text, self._surface
        width = max(self._lettering.measure(value, text)[0], 4 * text)
        left, right = rect.left + 9 * text, rect.right - width - text // 2
        is_shown = self._top + text <= rect.bottom and right - left > 2 * text
        if is_shown and not math.isnan(share):
            height = round(0.62 * text)
            box = pygame.Rect(left, self._top + round(0.18 * text), right - left, height)
            surface.fill(BACKGROUND, box)
            middle, half = box.centerx, box.width // 2
            length = round(half * abs(share))
            x = middle if share > 0.0 else middle - length
            surface.fill(colour, (x, box.top, length, height))
            surface.fill(GRID, (middle, box.top - 1, 1, height + 2))
        self.pair(name, value)


def _signed(value: float, digits: int, unit: str = "") -> str:
    """A number with its sign; 0 has none, and nan is no number."""
    if math.isnan(value):
        return "-"
    text = f"{value:+.{digits}f}"
    if float(text) == 0.0:
        text = text[1:]
    return text + (unit if unit == "°" else f" {unit}" if unit else "")
