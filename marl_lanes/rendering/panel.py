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
    PANEL,
    PHASES,
    SAFE_GAP,
    TEXT,
    WARNING,
    Colour,
)
from marl_lanes.rendering.spotlight import Focus
from marl_lanes.scenario import Scenario
from marl_lanes.traffic.machine.state import NONE, Phase
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.trajectory.frames import Frame, Rows


class Panel:
    """Draws the parts of the panel that the layout has a place for.

    Args:
        scenario: of the road.
        layout: with the places.
        lettering: for the text.
        title: of the picture, for example the policy's name.
    """

    def __init__(
        self, scenario: Scenario, layout: Layout, lettering: Lettering, title: str
    ) -> None:
        self._scenario = scenario
        self._layout = layout
        self._lettering = lettering
        self._title = title

    def draw_ground(self, surface: "pygame.Surface") -> None:
        """Draw the boxes."""
        for rect in self._layout.panel.values():
            pygame.draw.rect(surface, PANEL, rect, border_radius=self._layout.text // 2)

    def draw(self, surface: "pygame.Surface", frame: Frame, focus: Focus) -> None:
        """Draw the text of one time step."""
        for name, draw in (
            ("time", self._draw_time),
            ("agent", self._draw_agent),
            ("reward", self._draw_reward),
        ):
            if name in self._layout.panel:
                draw(surface, frame, focus)

    def _lines(self, name: str) -> tuple["pygame.Rect", int, list[int]]:
        """Inner rectangle of a part, size of text, and the tops of its lines."""
        rect = self._layout.panel[name]
        pad = round(0.6 * self._layout.text)
        inner = rect.inflate(-2 * pad, -2 * pad)
        count = inner.height // self._layout.line
        return inner, self._layout.text, [inner.top + k * self._layout.line for k in range(count)]

    def _draw_time(self, surface: "pygame.Surface", frame: Frame, focus: Focus) -> None:
        inner, text, tops = self._lines("time")
        put = self._lettering.put
        put(surface, f"{frame.time:.1f} s", inner.topleft, 2 * text, TEXT, within=inner)
        num_live = int((frame.rows["phase"] != Phase.ABSENT).sum())
        lines = [
            (self._title, TEXT),
            (self._scenario.name, TEXT),
            (f"{frame.rows.size} vehicles", MUTED),
            (f"{num_live} with a command", MUTED),
            (f"road {frame.road}", MUTED),
        ]
        for top, (line, colour) in zip(tops[2:], [one for one in lines if one[0]], strict=False):
            shown = self._lettering.shorten(line, text, inner.width)
            put(surface, shown, (inner.left, top), text, colour, within=inner)

    def _draw_agent(self, surface: "pygame.Surface", frame: Frame, focus: Focus) -> None:
        inner, text, tops = self._lines("agent")
        head, colour, pairs = self._describe(frame, focus)
        put = self._lettering.put
        put(surface, head, inner.topleft, text, colour, within=inner)
        for top, (name, value) in zip(tops[1:], pairs, strict=False):
            put(surface, name, (inner.left, top), text, MUTED, within=inner)
            put(surface, value, (inner.right, top), text, TEXT, anchor="topright", within=inner)

    def _describe(self, frame: Frame, focus: Focus) -> tuple[str, Colour, list[tuple[str, str]]]:
        if focus.row is None:
            return "No vehicle", MUTED, []
        row = frame.rows[focus.row]
        common = [
            ("speed", f"{row['speed'] * 3.6:.0f} km/h"),
            ("acceleration", f"{row['acceleration']:+.1f} m/s²"),
        ]
        if row["phase"] == Phase.ABSENT:
            head = f"No agent is live: vehicle {row['vehicle']}"
            return head, MUTED, [*common, ("lane", f"{row['lane']}")]
        phase = Phase(int(row["phase"]))
        side = "left" if row["direction"] > 0 else "right"
        head = f"changer_{row['command']} {phase.name.lower()}, to the {side}"
        pairs = [
            *common,
            ("gap ahead", self._gap(frame.rows, focus.row, "target_leader")),
            ("gap behind", self._gap(frame.rows, focus.row, "target_follower")),
            ("deviation", f"{row['lateral_deviation']:+.2f} m"),
            ("yaw", f"{math.degrees(row['direction'] * row['yaw']):+.1f}°"),
            ("steering", _number(row["action_yaw_acceleration"], "rad/s²")),
        ]
        if self._scenario.action.longitudinal is not None:
            pairs.append(("throttle", _number(row["action_acceleration"], "m/s²")))
        return head, PHASES[phase], pairs

    def _gap(self, rows: Rows, row: int, name: str) -> str:
        """Bumper to bumper."""
        other = rows[name][row]
        found = np.flatnonzero(rows["vehicle"] == other) if other != NONE else ()
        if not len(found):
            return "free"
        distance = abs(float(rows["position"][found[0]]) - float(rows["position"][row]))
        return f"{distance - self._scenario.vehicle.length:.1f} m"

    def _draw_reward(self, surface: "pygame.Surface", frame: Frame, focus: Focus) -> None:
        inner, text, tops = self._lines("reward")
        put = self._lettering.put
        put(surface, "Reward of the step", inner.topleft, text, TEXT, within=inner)
        if focus.row is None or np.isnan(frame.rows["reward"][focus.row]):
            return
        row = frame.rows[focus.row]
        for top, (name, value) in zip(
            tops[1:],
            [(name, float(row[name])) for name in (*CHANGER.reward_names, "reward")],
            strict=False,
        ):
            label = name.removeprefix("reward_").replace("_", " ")
            put(surface, label, (inner.left, top), text, MUTED, within=inner)
            number = f"{value:+.3f}"
            put(surface, number, (inner.right, top), text, TEXT, anchor="topright", within=inner)
            self._draw_bar(surface, inner, top, value)

    def _draw_bar(
        self, surface: "pygame.Surface", inner: "pygame.Rect", top: int, value: float
    ) -> None:
        text = self._layout.text
        left, right = inner.left + 10 * text, inner.right - 5 * text
        middle, half = (left + right) // 2, (right - left) // 2
        height = round(0.7 * text)
        y = top + round(0.15 * text)
        surface.fill(BACKGROUND, (middle - half, y, 2 * half, height))
        length = round(half * min(abs(value), 1.0))
        if length:
            x = middle if value > 0.0 else middle - length
            surface.fill(SAFE_GAP if value > 0.0 else WARNING, (x, y, length, height))
        surface.fill(GRID, (middle, y - 1, 1, height + 2))


def _number(value: float, unit: str) -> str:
    return "none" if math.isnan(value) else f"{value:+.2f} {unit}"
