"""A vehicle in the time after its change is complete; definitions are in docs/metrics.md."""

from dataclasses import dataclass, field
from math import nan

import numpy as np
from numpy.typing import NDArray

from marl_lanes.traffic.machine.compiled import on_columns
from marl_lanes.traffic.machine.state import Fate
from marl_lanes.traffic.road.geometry import is_wholly_in, lane_centre
from marl_lanes.traffic.simulator import Simulator

_is_wholly_in = on_columns(is_wholly_in)
_lane_centre = on_columns(lane_centre)

WATCHED_TIME = 10.0
"""[s] How long a vehicle is observed after it has completed."""
SETTLED_DEVIATION = 0.2
"""[m] A vehicle has settled once its deviation stays within this."""


@dataclass
class Aftermath:
    """A completed vehicle, for WATCHED_TIME or as long as it is on the road."""

    lateral_speed: float
    """At completion, positive beyond the target lane's centre [m/s]."""
    fate: Fate = Fate.STAYS
    """How the observation ended: STAYS if its time was over, LEAVES at the road's end."""
    has_left_lane: bool = False
    """Its body was in a lane that is not allowed, or off the road."""
    watched_time: float = 0.0
    """[s]"""
    deviation: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    """(N,) from the target lane's centre at completion and after each observed step, positive
    beyond the centre, as long as lane keeping follows that lane [m]."""

    @property
    def is_lost(self) -> bool:
        """It left the road over an edge, or its yaw reached 90 degrees."""
        return self.fate == Fate.STRAYS

    @property
    def has_collided(self) -> bool:
        """It collided with any vehicle, ahead, behind or beside."""
        return self.fate == Fate.COLLIDES

    @property
    def is_good(self) -> bool:
        """Neither lost, nor collided, nor out of its lane."""
        return not (self.is_lost or self.has_collided or self.has_left_lane)

    @property
    def peak_deviation(self) -> float:
        """Largest |deviation| [m]."""
        return float(np.abs(self.deviation).max(initial=0.0))

    def settling_time(self, time_step: float) -> float:
        """From completion until |deviation| stays within SETTLED_DEVIATION [s].

        nan if it does not: in the last observed step it is beyond, or it is lost or has collided.
        """
        beyond = np.flatnonzero(np.abs(self.deviation) > SETTLED_DEVIATION)
        if self.is_lost or self.has_collided:
            return nan
        if not beyond.size:
            return 0.0
        first_settled = int(beyond[-1]) + 1
        return nan if first_settled == len(self.deviation) else first_settled * time_step


_WATCHED = np.dtype(
    [
        ("index", "i8"),  # of the aftermath
        ("env", "i8"),
        ("vehicle", "i8"),  # slot
        ("id", "i8"),
        ("direction", "i8"),
        ("lane", "i8"),  # the change's target
        ("last_step", "i8"),
        ("num_steps", "i8"),
        # The allowed lanes of the body: those that it was in when lane keeping got its lane.
        ("lane_low", "i8"),
        ("lane_high", "i8"),
        ("has_left_lane", "?"),
        ("has_moved", "?"),  # lane keeping got another lane
    ]
)


class Watch:
    """Observes completed vehicles on the roads of a simulator while it is stepped."""

    def __init__(self, simulator: Simulator) -> None:
        self._simulator = simulator
        self._found: list[Aftermath] = []
        self._watched = np.zeros(0, _WATCHED)
        self._indices: list[NDArray[np.int64]] = []
        self._deviations: list[NDArray[np.float64]] = []

    @property
    def is_over(self) -> bool:
        """Whether no vehicle is left to observe."""
        return not self._watched.size

    def begin(self, envs: NDArray[np.intp], slots: NDArray[np.intp]) -> list[Aftermath]:
        """Begin to observe the vehicles of agents that have completed in the last step.

        Args:
            envs: (N,) roads.
            slots: (N,) agent slots.

        Returns:
            Their aftermaths, which ``finish`` fills in.
        """
        simulator = self._simulator
        step = simulator.scenario.time_step
        agents = simulator.agents[envs, slots]
        cars = simulator.vehicles[envs, agents["vehicle"]]
        new = np.zeros(len(envs), _WATCHED)
        new["index"] = len(self._found) + np.arange(len(envs))
        new["env"], new["vehicle"], new["id"] = envs, agents["vehicle"], cars["id"]
        new["direction"], new["lane"] = agents["direction"], agents["target_lane"]
        new["last_step"] = simulator.roads["step"][envs] + round(WATCHED_TIME / step)
        for name in ("lane_low", "lane_high"):
            new[name] = cars[name]
        lateral_speed = agents["direction"] * cars["speed"] * np.sin(cars["yaw"])
        found = [Aftermath(float(speed)) for speed in lateral_speed]
        for one, fate in zip(found, cars["fate"].tolist(), strict=True):
            one.fate = Fate(fate)
        self._found += found
        self._note_deviations(new, cars["lateral_position"])
        # A vehicle that completes in the step that reaches the road's end is already removed.
        self._watched = np.concatenate([self._watched, new[cars["fate"] == Fate.STAYS]])
        return found

    def advance(self) -> None:
        """Record the state after a step; call it before ``begin`` for the same step."""
        watched = self._watched
        if not watched.size:
            return
        simulator = self._simulator
        cars = simulator.vehicles[watched["env"], watched["vehicle"]]
        # A removed vehicle's record stays readable in the step that removes it.
        is_gone = cars["id"] != watched["id"]
        watched["num_steps"] += 1
        np.minimum(watched["lane_low"], cars["lane"], out=watched["lane_low"])
        np.maximum(watched["lane_high"], cars["lane"], out=watched["lane_high"])
        watched["has_left_lane"] |= cars["lane_low"] < watched["lane_low"]
        watched["has_left_lane"] |= cars["lane_high"] > watched["lane_high"]
        watched["has_left_lane"] |= is_gone & (cars["fate"] == Fate.STRAYS)
        is_in = _is_wholly_in(cars.view(np.recarray))
        for name in ("lane_low", "lane_high"):
            watched[name][is_in] = cars["lane"][is_in]
        watched["has_moved"] |= cars["lane"] != watched["lane"]
        keeps = ~watched["has_moved"]
        self._note_deviations(watched[keeps], cars["lateral_position"][keeps])
        is_over = is_gone | (simulator.roads["step"][watched["env"]] >= watched["last_step"])
        for row, fate in zip(watched[is_over], cars["fate"][is_over].tolist(), strict=True):
            found = self._found[row["index"]]
            found.fate = Fate(fate)
            found.has_left_lane = bool(row["has_left_lane"])
            found.watched_time = float(row["num_steps"] * simulator.scenario.time_step)
        self._watched = watched[~is_over]

    def finish(self) -> None:
        """Fill in the deviations; the observation must be over."""
        indices = np.concatenate([np.zeros(0, np.int64), *self._indices])
        deviations = np.concatenate([np.zeros(0), *self._deviations])
        order = np.argsort(indices, kind="stable")
        bounds = np.searchsorted(indices[order], np.arange(len(self._found) + 1))
        for index, found in enumerate(self._found):
            found.deviation = deviations[order[bounds[index] : bounds[index + 1]]]

    def _note_deviations(
        self, watched: NDArray[np.void], lateral_position: NDArray[np.float64]
    ) -> None:
        width = self._simulator.scenario.road.lane_width
        beyond = watched["direction"] * (lateral_position - _lane_centre(watched["lane"], width))
        self._indices.append(watched["index"].copy())
        self._deviations.append(beyond)
