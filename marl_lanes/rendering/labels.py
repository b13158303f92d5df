"""Labels in the camera's view: agents, outcomes, the gap's metres, positions, the scale."""

import math

import numpy as np

from marl_lanes.rendering.camera import Camera
from marl_lanes.rendering.ground import POST_SPACING, Gap
from marl_lanes.rendering.layout import Layout
from marl_lanes.rendering.lettering import Anchor, Lettering
from marl_lanes.rendering.loading import pygame
from marl_lanes.rendering.palette import BACKGROUND, MARKING, OUTCOMES, PHASES, TEXT, Colour
from marl_lanes.rendering.spotlight import Focus, Incident
from marl_lanes.scenario import Scenario
from marl_lanes.traffic.machine.state import NONE, Outcome, Phase
from marl_lanes.trajectory.frames import Frame

_SCALES = (200, 100, 50, 20, 10, 5, 2, 1)
"""[m] Lengths of the bar that shows the scale."""

_RING_SPEED = 6.0
"""[m/s] The ring around a lost vehicle grows."""


class Labels:
    """Writes into the camera's view.

    Args:
        scenario: of the road.
        layout: with the view's place.
        camera: of the view.
        lettering: for the text.
    """

    def __init__(
        self, scenario: Scenario, layout: Layout, camera: Camera, lettering: Lettering
    ) -> None:
        self._scenario = scenario
        self._layout = layout
        self._camera = camera
        self._lettering = lettering

    def draw(
        self,
        surface: "pygame.Surface",
        frame: Frame,
        focus: Focus,
        incidents: list[Incident],
        gap: Gap | None,
        cars: list["pygame.Rect"],
    ) -> None:
        """Write what is most important first; what then has no room is left out.

        Args:
            surface: the whole picture.
            frame: that is shown.
            focus: what the camera looks at.
            incidents: that are shown.
            gap: that is shown.
            cars: rectangles of the vehicles, over which labels stand only if there is no other way.
        """
        if not self._layout.panel:
            self._head(surface, frame, focus)
        self._draw_scale(surface)
        self._label_incidents(surface, frame, incidents, cars)
        if gap is not None:
            self._measure_gap(surface, gap)
        self._label_agents(surface, frame, focus, cars)
        self._label_positions(surface)

    def _put(
        self,
        surface: "pygame.Surface",
        text: str,
        place: tuple[float, float],
        colour: Colour,
        anchor: Anchor,
        chip: Colour | None = BACKGROUND,
    ) -> bool:
        box = self._lettering.put(
            surface,
            text,
            place,
            self._layout.small,
            colour,
            anchor=anchor,
            chip=chip,
            within=self._layout.camera,
        )
        return box is not None

    def _head(self, surface: "pygame.Surface", frame: Frame, focus: Focus) -> None:
        """Time and phase, where there is no panel."""
        edge = round(0.4 * self._layout.text)
        camera = self._layout.camera
        place = camera.left + edge, camera.top + edge
        self._put(surface, f"{frame.time:.1f} s", place, TEXT, "topleft")
        if focus.row is None or frame.rows["phase"][focus.row] == Phase.ABSENT:
            return
        row = frame.rows[focus.row]
        phase = Phase(int(row["phase"]))
        text = f"changer_{row['command']} {phase.name.lower()}"
        place = camera.right - edge, camera.top + edge
        self._put(surface, text, place, PHASES[phase], "topright")

    def _put_beside(
        self,
        surface: "pygame.Surface",
        text: str,
        at: tuple[float, float],
        body: tuple[float, float],
        colour: Colour,
        cars: list["pygame.Rect"],
    ) -> None:
        """A label at a vehicle, where it covers no vehicle; if there is no such place, above it.

        ``body`` is the vehicle's length and width [m].
        """
        x, y = at
        length, width = (size * self._camera.scale for size in body)
        places: list[tuple[Anchor, tuple[float, float]]] = [
            ("midbottom", (x, y - 0.75 * width)),
            ("midtop", (x, y + 0.75 * width)),
            ("midright", (x - 0.65 * length, y)),
            ("midleft", (x + 0.65 * length, y)),
        ]
        small = self._layout.small
        for anchor, place in places:
            box = self._lettering.find_room(text, place, small, anchor=anchor, is_boxed=True)
            if box.collidelist(cars) < 0 and self._put(surface, text, place, colour, anchor):
                return
        for anchor, place in places:
            if self._put(surface, text, place, colour, anchor):
                return

    def _label_incidents(
        self,
        surface: "pygame.Surface",
        frame: Frame,
        incidents: list[Incident],
        cars: list["pygame.Rect"],
    ) -> None:
        rows = frame.rows
        for incident in incidents:
            position, lateral = incident.position, incident.lateral_position
            found = np.flatnonzero(rows["vehicle"] == incident.vehicle)
            if found.size:
                position = float(rows["position"][found[0]])
                lateral = float(rows["lateral_position"][found[0]])
            x, y, _ = (float(value) for value in self._camera.place(position, lateral))
            colour = OUTCOMES[incident.outcome]
            if incident.outcome in (Outcome.COLLISION, Outcome.OFF_ROAD):
                radius = 0.65 * incident.length + _RING_SPEED * (frame.time - incident.time)
                pixels = radius * self._camera.scale
                surface.set_clip(self._layout.camera)
                pygame.draw.aacircle(surface, colour, (x, y), pixels, max(round(pixels / 10), 2))
                surface.set_clip(None)
            who = f"changer_{incident.command} " if incident.command != NONE else ""
            name = incident.outcome.name.lower().replace("_", " ")
            body = incident.length, incident.width
            self._put_beside(surface, who + name, (x, y), body, colour, cars)

    def _label_agents(
        self, surface: "pygame.Surface", frame: Frame, focus: Focus, cars: list["pygame.Rect"]
    ) -> None:
        """The followed agent by its name, the others by their numbers."""
        rows = frame.rows
        agents = np.flatnonzero(rows["phase"] != Phase.ABSENT)
        x, y, _ = self._camera.place(rows["position"][agents], rows["lateral_position"][agents])
        labelled = zip(agents.tolist(), x.tolist(), y.tolist(), strict=True)
        for row, column, line in sorted(labelled, key=lambda one: one[0] != focus.row):
            command, phase = rows["command"][row], Phase(int(rows["phase"][row]))
            text = f"changer_{command}" if row == focus.row else f"{command}"
            body = float(rows["length"][row]), float(rows["width"][row])
            self._put_beside(surface, text, (column, line), body, PHASES[phase], cars)

    def _measure_gap(self, surface: "pygame.Surface", gap: Gap) -> None:
        """The metres of the gap's distances, where the text is shorter than its line."""
        camera, lane_width = self._camera, self._scenario.road.lane_width
        for start, end in gap.distances:
            text = f"{end - start:.1f} m"
            low, high = max(start, camera.start), min(end, camera.end)
            width = self._lettering.measure(text, self._layout.small)[0] + self._layout.text
            if (high - low) * camera.scale >= width:
                x, y, _ = camera.place(0.5 * (low + high), (gap.lane + 0.5) * lane_width)
                self._put(surface, text, (float(x), float(y)), TEXT, "center")

    def _label_positions(self, surface: "pygame.Surface") -> None:
        """Positions at the posts on the left side."""
        camera = self._camera
        first = max(math.ceil(camera.reach[0] / POST_SPACING), 0)
        last = min(camera.reach[1], self._scenario.road.length) / POST_SPACING
        places = POST_SPACING * np.arange(first, math.floor(last) + 1)
        x, y, _ = camera.place(places, camera.road_width + 2.2)
        for place, column, line in zip(places.tolist(), x.tolist(), y.tolist(), strict=True):
            self._put(surface, f"{place:.0f} m", (column, line), TEXT, "midbottom", None)

    def _draw_scale(self, surface: "pygame.Surface") -> None:
        camera, view, text = self._camera, self._layout.camera, self._layout.text
        length = next(one for one in _SCALES if one * camera.scale < 0.2 * view.width)
        right, bottom = view.right - text, view.bottom - round(0.8 * text)
        width, stroke = round(length * camera.scale), max(text // 7, 1)
        end = round(0.4 * text)
        place = right - width / 2, bottom - end
        if self._put(surface, f"{length} m", place, TEXT, "midbottom"):
            surface.fill(MARKING, (right - width, bottom - stroke, width, stroke))
            for x in (right - width, right - stroke):
                surface.fill(MARKING, (x, bottom - end, stroke, end))
