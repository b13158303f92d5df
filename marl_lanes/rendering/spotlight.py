"""Whom the camera follows, and what has just happened."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from marl_lanes.rendering.options import ViewOptions
from marl_lanes.traffic.machine.state import NONE, Fate, Outcome, Phase
from marl_lanes.trajectory.frames import Frame
from marl_lanes.trajectory.signals import are_lost

HOLD_TIME = 2.0
"""[s] An outcome is shown for so long, and the camera stays."""


_PLACE = ("position", "lateral_position", "length", "width")
"""Columns of an incident."""


class Incident(NamedTuple):
    """A command's outcome, or the loss of a vehicle."""

    vehicle: int
    command: int
    """Of the vehicle, or -1."""
    outcome: Outcome
    time: float
    """[s]"""
    position: float
    lateral_position: float
    """Of the vehicle in that step [m]."""
    length: float
    width: float
    """Of the vehicle's body [m]."""


class Focus(NamedTuple):
    """What the camera looks at."""

    vehicle: int
    """Its number; -1 if none was ever there."""
    row: int | None
    """Of the frame; None if the vehicle is not there any more."""
    position: float
    """[m]"""
    lane: int
    """The lane that the vehicle keeps."""


class Spotlight:
    """Chooses the followed vehicle, and keeps it while it is of interest.

    By default it is an agent: one that steers before one that waits, then the older command. It is
    followed until its command has ended, and ``HOLD_TIME`` longer. Without an agent it is the
    vehicle that was followed last, or the next one that may get a command.
    """

    def __init__(self, options: ViewOptions) -> None:
        self._given = self._options = options
        self.forget()

    @property
    def followed(self) -> int:
        """Number of the followed vehicle; -1 if there is none."""
        return self._vehicle

    def follow(self, vehicle: int | None) -> None:
        """Follow a vehicle from the next frame on; None: the one of most interest."""
        self._options = replace(self._options, follow=vehicle)
        self._until = -np.inf
        if vehicle is None:
            self._vehicle = NONE

    def forget(self) -> None:
        """Begin anew with the options as they were given."""
        self._options = self._given
        self._road = self._step = NONE
        self._vehicle = NONE
        self._position, self._lane = 0.0, 0
        self._until = -np.inf
        self._named = NONE
        self.incidents: list[Incident] = []
        """Those of the last ``HOLD_TIME``."""

    def look(self, frame: Frame) -> Focus:
        """The focus of the next frame of the road, or of the same again."""
        if frame.road != self._road or frame.step < self._step:
            self.forget()
        self._note_incidents(frame)
        self._road, self._step = frame.road, frame.step
        self._vehicle = self._choose(frame)
        found = np.flatnonzero(frame.rows["vehicle"] == self._vehicle)
        row = int(found[0]) if found.size else None
        if row is not None:
            self._position = float(frame.rows["position"][row])
            self._lane = int(frame.rows["lane"][row])
        return Focus(self._vehicle, row, self._position, self._lane)

    def _note_incidents(self, frame: Frame) -> None:
        self.incidents = [one for one in self.incidents if frame.time < one.time + HOLD_TIME]
        known = {one.vehicle for one in self.incidents if one.time == frame.time}
        rows = frame.rows
        has_ended = rows["outcome"] != Outcome.UNFINISHED
        for index in np.flatnonzero(are_lost(rows) | has_ended).tolist():
            row = rows[index]
            vehicle = int(row["vehicle"])
            if vehicle in known:
                continue
            result = Outcome(int(row["outcome"]))
            if result == Outcome.UNFINISHED:
                is_collision = row["fate"] == Fate.COLLIDES
                result = Outcome.COLLISION if is_collision else Outcome.OFF_ROAD
            place = (float(row[name]) for name in _PLACE)
            incident = Incident(vehicle, int(row["command"]), result, frame.time, *place)
            self.incidents.append(incident)
            if vehicle == self._vehicle:
                self._until = frame.time + HOLD_TIME

    def _choose(self, frame: Frame) -> int:
        rows, follow = frame.rows, self._options.follow
        if isinstance(follow, int):
            if (rows["vehicle"] == follow).any():
                return follow
        elif self._options.followed_command is not None:
            found = rows["vehicle"][rows["command"] == self._options.followed_command]
            if found.size:
                self._named = int(found[0])
            if (rows["vehicle"] == self._named).any():
                return self._named
        if frame.time < self._until:
            return self._vehicle
        is_live = rows["phase"] != Phase.ABSENT
        if is_live.any():
            agents = rows[is_live]
            if self._vehicle in agents["vehicle"]:
                return self._vehicle
            is_steering = agents["phase"] != Phase.WAITING
            return int(agents["vehicle"][np.lexsort((agents["command"], ~is_steering))[0]])
        if (rows["vehicle"] == self._vehicle).any() or rows.size == 0:
            return self._vehicle
        return self._choose_bystander(frame)

    def _choose_bystander(self, frame: Frame) -> int:
        """The foremost vehicle before the place of commands, in a lane that gets them."""
        rows, scenario = frame.rows, frame.scenario
        place = scenario.command.position[0]
        is_before = rows["position"] < place
        is_commanded = np.isin(rows["lane"], scenario.command_lanes)
        distance = np.abs(rows["position"] - place)
        return int(rows["vehicle"][np.lexsort((distance, ~is_commanded, ~is_before))[0]])
