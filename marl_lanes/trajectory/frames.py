"""The rows of one time step, read from the roads of a simulator."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from marl_lanes.scenario import Scenario
from marl_lanes.traffic.command.phases import reference_lane
from marl_lanes.traffic.machine.compiled import on_columns
from marl_lanes.traffic.machine.state import NONE, Fate, Outcome, Phase
from marl_lanes.traffic.road.geometry import lane_centre
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.traffic.roles.follower import FOLLOWER
from marl_lanes.traffic.simulator import Simulator
from marl_lanes.trajectory.columns import new_rows, set_bodies

Rows = NDArray[np.void]
"""(N,) ROW."""

_lane_centre = on_columns(lane_centre)
_reference_lane = on_columns(reference_lane)

_OF_VEHICLE = (
    "position",
    "lateral_position",
    "speed",
    "acceleration",
    "yaw",
    "yaw_rate",
    "yaw_acceleration",
    "desired_speed",
    "lane",
    "lane_low",
    "lane_high",
    "moving_over",
    "profile",
    "disposition",
    "fate",
)
_OF_AGENT = (
    "command",
    "phase",
    "outcome",
    "direction",
    "origin_lane",
    "target_lane",
    "num_aborts",
    "reward",
)
_NEIGHBORS = ("leader", "follower", "target_leader", "target_follower")


@dataclass(frozen=True)
class Frame:
    """One road at one time step.

    Args:
        scenario: of the road.
        road: index of the road.
        step: steps since the warm-up ended.
        rows: (N,) ROW, one for each vehicle, also those that the step removed.
    """

    scenario: Scenario
    road: int
    step: int
    rows: Rows

    @property
    def time(self) -> float:
        """Since the warm-up ended [s]."""
        return self.step * self.scenario.time_step


class FrameReader:
    """Reads roads of a simulator as rows of a trajectory, without changing anything.

    A vehicle's number is gone in the step that removes the vehicle, and which actions count is
    known only before the step. So ``note`` has to be called before every step (``read`` does it);
    after a step without it, vehicles that were removed and the actions are missing.

    Args:
        simulator: to read.
        roads: indices of the roads within the simulator, in any order; by default all.
    """

    def __init__(self, simulator: Simulator, roads: Sequence[int] | None = None) -> None:
        self.simulator = simulator
        chosen = range(simulator.num_envs) if roads is None else roads
        for road in chosen:
            if not 0 <= road < simulator.num_envs:
                raise ValueError(f"road = {road}: must be 0 to {simulator.num_envs - 1}")
        self.roads = np.unique(np.asarray(list(chosen), np.intp))
        self.note()

    def note(self) -> None:
        """Remember what the next step may remove."""
        simulator, roads = self.simulator, self.roads
        self._step = simulator.roads["step"][roads].copy()
        self._ids = simulator.vehicles["id"][roads].copy()
        self._masks = [mask[roads] for mask in (simulator.is_steering, simulator.is_acting)]
        followers = simulator.state.followers[roads]
        paired = followers["policy"] != NONE
        self._drivers = np.where(paired, followers["vehicle"], NONE)

    def read(self) -> Rows:
        """The rows of all vehicles on the roads, ordered by road and vehicle slot."""
        simulator, roads = self.simulator, self.roads
        vehicles = simulator.vehicles[roads]
        step = simulator.roads["step"][roads]
        is_noted = (step == self._step + 1)[:, None]
        is_gone = (vehicles["id"] == NONE) & (vehicles["fate"] != Fate.STAYS)
        ids = np.where(is_gone & is_noted, self._ids, vehicles["id"])
        envs, slots = np.nonzero(ids != NONE)
        cars = vehicles[envs, slots]
        rows = new_rows(envs.size)
        rows["road"] = simulator.first_road + roads[envs]
        rows["step"] = step[envs]
        rows["time"] = step[envs] * simulator.scenario.time_step
        rows["vehicle"] = ids[envs, slots]
        for name in _OF_VEHICLE:
            rows[name] = cars[name]
        set_bodies(rows, simulator.scenario)
        changer = cars["changer"]
        rows["changer"] = np.where(changer == NONE, NONE, ids[envs, changer])
        index = np.full(ids.shape, NONE)
        index[envs, slots] = np.arange(envs.size)
        self._add_collisions(rows, index, ids, step)
        self._add_changers(rows, index, ids, is_noted)
        self._add_followers(rows, index, is_noted)
        self.note()
        return rows

    def read_frames(self) -> list[Frame]:
        """The frames of the roads, in their order."""
        rows, scenario = self.read(), self.simulator.scenario
        steps = self.simulator.roads["step"][self.roads].tolist()
        numbers = (self.simulator.first_road + self.roads).tolist()
        starts = np.searchsorted(rows["road"], numbers, side="left").tolist()
        stops = np.searchsorted(rows["road"], numbers, side="right").tolist()
        return [
            Frame(scenario, road, step, rows[start:stop])
            for road, step, start, stop in zip(numbers, steps, starts, stops, strict=True)
        ]

    def _add_collisions(
        self, rows: Rows, index: NDArray[np.intp], ids: NDArray[np.int64], step: NDArray[np.int64]
    ) -> None:
        records = self.simulator.state.collisions[self.roads]
        is_new = (records["rear_id"] != NONE) & (records["step"] == step[:, None])
        for env, number in np.argwhere(is_new).tolist():
            record = records[env, number]
            for own, other in (("rear_id", "front_id"), ("front_id", "rear_id")):
                found = index[env, ids[env] == record[own]]
                rows["collided_with"][found] = record[other]

    def _add_changers(
        self,
        rows: Rows,
        index: NDArray[np.intp],
        ids: NDArray[np.int64],
        is_noted: NDArray[np.bool_],
    ) -> None:
        simulator = self.simulator
        agents = simulator.agents[self.roads]
        is_known = (agents["phase"] != Phase.ABSENT) | (agents["outcome"] != Outcome.UNFINISHED)
        is_known &= agents["vehicle"] != NONE
        envs, slots = np.nonzero(is_known)
        found = index[envs, agents["vehicle"][envs, slots]]
        # A vehicle that was removed in a step without a note has no row.
        envs, slots, found = (array[found != NONE] for array in (envs, slots, found))
        agent = agents[envs, slots]
        for name in _OF_AGENT:
            rows[name][found] = agent[name]
        for name in _NEIGHBORS:
            other = agent[name]
            rows[name][found] = np.where(other == NONE, NONE, ids[envs, other])
        lane = _reference_lane(agent["phase"], agent["origin_lane"], agent["target_lane"])
        centre = _lane_centre(lane, simulator.scenario.road.lane_width)
        deviation = agent["direction"] * (centre - rows["lateral_position"][found])
        rows["lateral_deviation"][found] = deviation
        for name, values in CHANGER.terms_of(agent).items():
            rows[name][found] = values
        low, high = CHANGER.action_bounds(simulator.scenario)
        actions = np.clip(simulator.actions[self.roads][envs, slots], low, high)
        names = ("action_yaw_acceleration", "action_acceleration")
        for column, (name, mask) in enumerate(zip(names, self._masks, strict=True)):
            if column < simulator.num_actions:
                has_acted = (mask & is_noted)[envs, slots]
                rows[name][found] = np.where(has_acted, actions[:, column], np.nan)

    def _add_followers(
        self, rows: Rows, index: NDArray[np.intp], is_noted: NDArray[np.bool_]
    ) -> None:
        """The external drivers that were paired before the step."""
        envs, slots = np.nonzero((self._drivers != NONE) & is_noted)
        found = index[envs, self._drivers[envs, slots]]
        envs, slots, found = (array[found != NONE] for array in (envs, slots, found))
        low, high = FOLLOWER.action_bounds(self.simulator.scenario)
        given = self.simulator.follower_actions[self.roads][envs, slots, 0]
        rows["follower_action"][found] = np.clip(given, low[0], high[0])
        records = self.simulator.state.followers[self.roads][envs, slots]
        rows["follower_reward"][found] = records["reward"]
        for name, values in FOLLOWER.terms_of(records).items():
            rows[f"follower_{name}"][found] = values
