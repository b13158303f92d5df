"""The camera's view: ground, vehicles, the gap that the rule looks at, and labels."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from marl_lanes.rendering.camera import Camera
from marl_lanes.rendering.ground import Gap, Ground
from marl_lanes.rendering.labels import Labels
from marl_lanes.rendering.layout import Layout
from marl_lanes.rendering.lettering import Lettering
from marl_lanes.rendering.loading import pygame
from marl_lanes.rendering.palette import REFUSED_GAP, SAFE_GAP
from marl_lanes.rendering.spotlight import Focus, Incident
from marl_lanes.rendering.sprites import Look, Sprites
from marl_lanes.scenario import Scenario
from marl_lanes.traffic.machine.state import NONE, Disposition, Phase
from marl_lanes.trajectory.frames import Frame, Rows
from marl_lanes.trajectory.signals import are_braking, are_commanded, are_lost, find_indicators

BLINK_TIME = 0.4
"""[s] An indicator is lit and dark for so long."""


class Cars(NamedTuple):
    """Vehicles in the camera's view."""

    rows: list[int]
    """Of the frame."""
    x: list[float]
    y: list[float]
    """Middles [pixel]."""
    angles: list[float]
    """[rad] counterclockwise from the right."""


def is_lit(time: float) -> bool:
    """Whether indicators are lit at a time since the warm-up's end [s]."""
    return math.floor(time / BLINK_TIME + 1e-6) % 2 == 0


def find_looks(rows: Rows, time: float) -> list[Look]:
    """What the vehicles look like at a time [s]."""
    columns = (
        are_commanded(rows),
        np.minimum(rows["disposition"], Disposition.EXTERNAL),
        are_braking(rows),
        find_indicators(rows) * is_lit(time),
        are_lost(rows),
    )
    return list(map(Look, *(column.tolist() for column in columns)))


def find_gap(rows: Rows, row: int, camera: Camera) -> Gap | None:
    """The gap between the target follower and the target leader of an agent.

    Where there is none, the gap reaches to the end of the picture. None without a command.
    """
    agent = rows[row]
    if agent["phase"] == Phase.ABSENT:
        return None
    position, half = float(agent["position"]), 0.5 * float(agent["length"])
    rear, front = camera.reach
    distances = []
    follower, leader = (
        np.flatnonzero((rows["vehicle"] == agent[name]) & (agent[name] != NONE))
        for name in ("target_follower", "target_leader")
    )
    if follower.size:
        behind = rows[follower[0]]
        rear = float(behind["position"] + 0.5 * behind["length"])
        distances.append((rear, position - half))
    if leader.size:
        ahead = rows[leader[0]]
        front = float(ahead["position"] - 0.5 * ahead["length"])
        distances.append((position + half, front))
    is_accepted = agent["phase"] == Phase.ENGAGED
    return Gap(
        int(agent["target_lane"]),
        rear,
        front,
        SAFE_GAP if is_accepted else REFUSED_GAP,
        not is_accepted,
        tuple(one for one in distances if one[0] < one[1]),
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
        self._place = layout.camera
        self._camera = camera
        self._ground = Ground(scenario, camera)
        self._sprites = [
            Sprites(length * camera.scale, width * camera.scale)
            for length, width in map(scenario.body_of, scenario.drivers.profiles)
        ]
        self._labels = Labels(scenario, layout, camera, lettering)

    def draw(
        self, surface: "pygame.Surface", frame: Frame, focus: Focus, incidents: list[Incident]
    ) -> None:
        """Draw the view into its place on the whole picture."""
        rows, camera = frame.rows, self._camera
        gap = None if focus.row is None else find_gap(rows, focus.row, camera)
        view = surface.subsurface(self._place)
        self._ground.draw(view, None if gap is None else gap.lane, gap)
        cars = self._find_cars(rows)
        seen = rows[cars.rows]
        looks = find_looks(seen, frame.time)
        found = [
            self._sprites[profile].find(*one)
            for profile, *one in zip(
                seen["profile"].tolist(), looks, cars.x, cars.y, cars.angles, strict=True
            )
        ]
        view.fblits(found, pygame.BLEND_PREMULTIPLIED)
        self._labels.draw(surface, frame, focus, incidents, gap, self._cover(cars, seen))

    def _find_cars(self, rows: Rows) -> Cars:
        camera = self._camera
        x, y, heading = camera.place(rows["position"], rows["lateral_position"])
        margin = camera.scale * rows["length"]
        is_seen = (x > -margin) & (x < camera.size[0] + margin)
        is_seen &= (y > -margin) & (y < camera.size[1] + margin)
        # A road may turn so far that another piece of it would be in the picture.
        is_seen &= (rows["position"] >= camera.reach[0]) & (rows["position"] <= camera.reach[1])
        seen = np.flatnonzero(is_seen)
        angle = (heading + rows["yaw"])[seen]
        return Cars(seen.tolist(), x[seen].tolist(), y[seen].tolist(), angle.tolist())

    def _cover(self, cars: Cars, rows: Rows) -> list["pygame.Rect"]:
        """Upright rectangles around the vehicles."""
        angles: NDArray[np.float64] = np.asarray(cars.angles)
        cosine, sine = np.abs(np.cos(angles)), np.abs(np.sin(angles))
        length, width = (self._camera.scale * rows[name] for name in ("length", "width"))
        wide = np.ceil(length * cosine + width * sine).astype(int).tolist()
        tall = np.ceil(length * sine + width * cosine).astype(int).tolist()
        return [
            pygame.Rect(int(x - 0.5 * w), int(y - 0.5 * h), w, h)
            for x, y, w, h in zip(cars.x, cars.y, wide, tall, strict=True)
        ]
