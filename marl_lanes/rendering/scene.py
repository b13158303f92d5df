"""The vehicles in the camera's view, the gap of the followed agent, and labels at them."""

import math

import numpy as np

from marl_lanes.rendering.camera import Camera
from marl_lanes.rendering.ground import POST_SPACING, Gap, Ground
from marl_lanes.rendering.layout import Layout
from marl_lanes.rendering.lettering import Lettering
from marl_lanes.rendering.loading import pygame
from marl_lanes.rendering.palette import (
    BACKGROUND,
    MARKING,
    MUTED,
    OUTCOMES,
    PHASES,
    REFUSED_GAP,
    SAFE_GAP,
    TEXT,
)
from marl_lanes.rendering.spotlight import Focus, Incident
from marl_lanes.rendering.sprites import Look, Sprites
from marl_lanes.scenario import Scenario
from marl_lanes.traffic.machine.state import NONE, Disposition, Fate, Outcome, Phase
from marl_lanes.trajectory.frames import Frame, Rows

BRAKING = -0.5
"""[m/s^2] A vehicle that decelerates more shows its brake lights."""

BLINK_TIME = 0.4
"""[s] An indicator is lit and dark for so long."""


def is_blinking(time: float) -> bool:
    """Whether indicators are lit at a time since the warm-up's end [s]."""
    return math.floor(time / BLINK_TIME + 1e-6) % 2 == 0


def look_of(row: "np.void", *, is_lit: bool) -> Look:
    """What the vehicle of a row looks like."""
    is_agent = row["phase"] != Phase.ABSENT or row["outcome"] != Outcome.UNFINISHED
    side = int(row["direction"]) if is_agent else int(row["moving_over"])
    return Look(
        is_changer=bool(is_agent),
        disposition=Disposition(min(int(row["disposition"]), Disposition.EXTERNAL)),
        is_braking=bool(row["acceleration"] < BRAKING),
        indicator=side if is_lit else 0,
        is_lost=int(row["fate"]) in (Fate.COLLIDES, Fate.STRAYS),
    )


def find_gap(scenario: Scenario, rows: Rows, row: int, camera: Camera) -> Gap | None:
    """The gap between the target follower and the target leader of an agent."""
    agent = rows[row]
    if agent["phase"] == Phase.ABSENT:
        return None
    half = 0.5 * scenario.vehicle.length
    bounds = []
    for name, side, limit in (
        ("target_follower", half, camera.start),
        ("target_leader", -half, camera.end),
    ):
        found = np.flatnonzero(rows["vehicle"] == agent[name]) if agent[name] != NONE else ()
        bounds.append(float(rows["position"][found[0]]) + side if len(found) else limit)
    is_accepted = agent["phase"] == Phase.ENGAGED
    return Gap(
        int(agent["target_lane"]),
        bounds[0],
        bounds[1],
        SAFE_GAP if is_accepted else REFUSED_GAP,
        not is_accepted,
    )


class Scene:
    """Draws the camera's view.

    Args:
        scenario: of the road.
        layout: with the view's place.
        camera: of the view.
        lettering: for the labels.
    """

    def __init__(
        self, scenario: Scenario, layout: Layout, camera: Camera, lettering: Lettering
    ) -> None:
        self._scenario = scenario
        self._layout = layout
        self._camera = camera
        self._lettering = lettering
        self._ground = Ground(scenario, camera)
        body = scenario.vehicle
        self._sprites = Sprites(body.length * camera.scale, body.width * camera.scale)
        self._view = pygame.Surface(layout.camera.size, depth=32)

    def draw(
        self, surface: "pygame.Surface", frame: Frame, focus: Focus, incidents: list[Incident]
    ) -> None:
        """Draw the view into its place on the whole picture."""
        rows, camera = frame.rows, self._camera
        gap = None if focus.row is None else find_gap(self._scenario, rows, focus.row, camera)
        self._ground.draw(self._view, None if gap is None else gap.lane, gap)
        x, y, heading = camera.place(rows["position"], rows["lateral_position"])
        margin = self._sprites.length
        is_seen = (x > -margin) & (x < camera.size[0] + margin)
        is_seen &= (y > -margin) & (y < camera.size[1] + margin)
        angle = heading + rows["yaw"]
        is_lit = is_blinking(frame.time)
        pictures = [
            self._sprites.find(
                look_of(rows[row], is_lit=is_lit), float(x[row]), float(y[row]), float(angle[row])
            )
            for row in np.flatnonzero(is_seen).tolist()
        ]
        self._view.fblits(pictures, pygame.BLEND_PREMULTIPLIED)
        surface.blit(self._view, self._layout.camera)
        self._label_incidents(surface, frame, incidents)
        if gap is not None and focus.row is not None:
            self._measure_gap(surface, frame, focus.row, gap)
        self._label_agents(surface, frame, focus, x, y, is_seen)
        self._label_road(surface)

    def _put_above(
        self, surface: "pygame.Surface", text: str, x: float, y: float, colour: tuple[int, int, int]
    ) -> None:
        """A label above a vehicle, or below it where there is no room."""
        lettering, size = self._lettering, self._layout.small
        reach = 0.8 * self._sprites.width
        within = self._layout.camera
        for anchor, place in (("midbottom", y - reach), ("midtop", y + reach)):
            if lettering.put(
                surface,
                text,
                (x, place),
                size,
                colour,
                anchor=anchor,  # type: ignore[arg-type]
                chip=BACKGROUND,
                within=within,
            ):
                return

    def _label_incidents(
        self, surface: "pygame.Surface", frame: Frame, incidents: list[Incident]
    ) -> None:
        for incident in incidents:
            position, lateral = incident.position, incident.lateral_position
            found = np.flatnonzero(frame.rows["vehicle"] == incident.vehicle)
            if found.size:
                position = float(frame.rows["position"][found[0]])
                lateral = float(frame.rows["lateral_position"][found[0]])
            x, y, _ = self._camera.place(position, lateral)
            colour = OUTCOMES[incident.outcome]
            if incident.outcome in (Outcome.COLLISION, Outcome.OFF_ROAD):
                radius = self._sprites.length * (0.7 + 0.8 * (frame.time - incident.time))
                pygame.draw.aacircle(
                    surface, colour, (float(x), float(y)), radius, max(2, round(radius / 12))
                )
            who = f"changer_{incident.command} " if incident.command != NONE else ""
            name = incident.outcome.name.lower().replace("_", " ")
            self._put_above(surface, who + name, float(x), float(y), colour)

    def _label_agents(
        self,
        surface: "pygame.Surface",
        frame: Frame,
        focus: Focus,
        x: "np.ndarray[tuple[int], np.dtype[np.float64]]",
        y: "np.ndarray[tuple[int], np.dtype[np.float64]]",
        is_seen: "np.ndarray[tuple[int], np.dtype[np.bool_]]",
    ) -> None:
        rows = frame.rows
        agents = np.flatnonzero(is_seen & (rows["phase"] != Phase.ABSENT)).tolist()
        for row in sorted(agents, key=lambda row: row != focus.row):
            command, phase = int(rows["command"][row]), Phase(int(rows["phase"][row]))
            text = f"changer_{command}" if row == focus.row else f"{command}"
            self._put_above(surface, text, float(x[row]), float(y[row]), PHASES[phase])

    def _measure_gap(self, surface: "pygame.Surface", frame: Frame, row: int, gap: Gap) -> None:
        """The metres before and behind the agent, in the target lane."""
        rows, camera = frame.rows, self._camera
        half = 0.5 * self._scenario.vehicle.length
        position = float(rows["position"][row])
        lateral = (gap.lane + 0.5) * self._scenario.road.lane_width
        for name, start, end in (
            ("target_leader", position + half, gap.front),
            ("target_follower", gap.rear, position - half),
        ):
            if rows[name][row] == NONE:
                continue
            shown = max(start, camera.start + 2.0), min(end, camera.end - 2.0)
            middle = 0.5 * (shown[0] + shown[1])
            x, y, _ = camera.place(middle, lateral)
            self._lettering.put(
                surface,
                f"{end - start:.1f} m",
                (float(x), float(y)),
                self._layout.small,
                TEXT,
                anchor="center",
                chip=BACKGROUND,
                within=self._layout.camera,
            )

    def _label_road(self, surface: "pygame.Surface") -> None:
        """Positions at the posts, and the scale."""
        camera, layout = self._camera, self._layout
        first = max(math.ceil(camera.start / POST_SPACING), 0)
        last = min(camera.end, self._scenario.road.length) / POST_SPACING
        for number in range(first, math.floor(last) + 1):
            x, y, _ = camera.place(number * POST_SPACING, camera.road_width + 2.2)
            self._lettering.put(
                surface,
                f"{number * POST_SPACING:.0f} m",
                (float(x), float(y)),
                layout.small,
                MUTED,
                anchor="midbottom",
                within=layout.camera,
            )
        length = next(one for one in (50, 20, 10, 5) if one * camera.scale < 0.25 * camera.size[0])
        right, bottom = layout.camera.right - layout.text, layout.camera.bottom - layout.text
        width = round(length * camera.scale)
        surface.fill(MARKING, (right - width, bottom, width, 2))
        for end in (right - width, right - 2):
            surface.fill(MARKING, (end, bottom - 4, 2, 6))
        self._lettering.put(
            surface,
            f"{length} m",
            (right - width / 2, bottom - 4),
            layout.small,
            TEXT,
            anchor="midbottom",
            within=layout.camera,
        )
