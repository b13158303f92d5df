"""Maneuvers of a policy on seeded traffic, recorded step by step."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import ceil
from typing import Any

import numpy as np
from numpy.typing import NDArray

from marl_lanes.envs.followers import find_policies
from marl_lanes.evaluation.aftermath import Aftermath, Watch
from marl_lanes.evaluation.driving import Policy, drive
from marl_lanes.memory import check_memory
from marl_lanes.scenario import Scenario, ScenarioError, load_scenario
from marl_lanes.traffic.command.phases import reference_lane
from marl_lanes.traffic.counterfactual import accelerations_without_change
from marl_lanes.traffic.machine.compiled import on_columns
from marl_lanes.traffic.machine.state import NONE, CollisionKind, Outcome
from marl_lanes.traffic.road.geometry import is_body_in, lane_centre, road_turning
from marl_lanes.traffic.road.neighbors import bumper_gap
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.traffic.roles.external import FollowerPolicy
from marl_lanes.traffic.simulator import Simulator

_is_body_in = on_columns(is_body_in)
_lane_centre = on_columns(lane_centre)
_reference_lane = on_columns(reference_lane)
_bumper_gap = on_columns(bumper_gap)

Observe = Callable[[Simulator], Callable[[], object]]
"""Given the roads before their first step; returns what is called after every step."""

MANEUVER_BYTES = 80_000
"""Memory for one maneuver and its share of the road at the end of a rollout, at the least."""

TRACE = np.dtype(
    [
        ("env", "i8"),
        ("command", "i8"),
        ("step", "i8"),  # of the road, after the step
        ("direction", "i4"),  # +1 to the left, -1 to the right
        ("phase", "i4"),  # phase in which the agent acted
        # Before the step, in the road frame.
        ("position_before", "f8"),
        ("lateral_position_before", "f8"),
        ("speed_before", "f8"),
        # Before the step, in the maneuver frame.
        ("deviation_before", "f8"),
        ("yaw_before", "f8"),
        ("yaw_rate_before", "f8"),
        ("curvature", "f8"),
        ("turning_before", "f8"),  # yaw rate relative to the road's turning
        ("acceleration_before", "f8"),
        ("follower_gap_before", "f8"),  # inf where there is none
        # After the step, in the maneuver frame.
        ("speed", "f8"),
        ("acceleration", "f8"),
        ("lateral_deviation", "f8"),
        ("yaw", "f8"),
        ("yaw_rate", "f8"),
        ("yaw_acceleration", "f8"),
        ("turning", "f8"),  # yaw rate relative to the road's turning
        ("position", "f8"),
        ("is_over_marking", "?"),  # the body is in the target lane
        ("is_in_origin", "?"),  # the body is in the origin lane
        ("length", "f8"),  # of the vehicle
        # Of the target lane's neighbors after the step; inf and nan where there is none.
        ("leader_id", "i8"),  # serial number on its road, -1 where there is none
        ("leader_gap", "f8"),
        ("leader_speed", "f8"),
        ("leader_length", "f8"),
        ("follower_id", "i8"),  # serial number on its road, -1 where there is none
        ("follower_gap", "f8"),
        ("follower_speed", "f8"),
        ("follower_acceleration", "f8"),
        # The same in the origin lane.
        ("origin_leader_gap", "f8"),
        ("origin_leader_speed", "f8"),
        ("origin_follower_gap", "f8"),
        ("origin_follower_speed", "f8"),
        # Braking beyond that of car following without the lane change, in the state before the
        # step, of the changer and of the vehicle behind it then; nan where there was none.
        ("imposed_on_changer", "f8"),
        ("imposed_on_follower", "f8"),
        *((name, "f8") for name in CHANGER.reward_names),
    ]
)
"""One row per step in which an agent steered."""


@dataclass
class Maneuver:
    """One command, from its start to its outcome."""

    env: int
    command: int
    vehicle: int
    """Serial number of the commanded vehicle on its road."""
    outcome: Outcome
    num_aborts: int
    born_step: int
    """The road's step at the command."""
    waiting_time: float
    """From the command until it first engaged, or until it ended [s]."""
    time_to_end: float
    """From the command to the outcome [s]."""
    has_side_collision: bool
    """It ended in a collision of the kind side while the agent steered."""
    episode_reward: float
    """Sum of all reward terms since the command, with the waiting steps."""
    trace: NDArray[np.void]
    """(N,) TRACE, ordered by time; empty if it never engaged."""
    aftermath: Aftermath | None = None
    """The vehicle in the time after completion; None if the change was not completed."""

    def __post_init__(self) -> None:
        """Reject a completed change without its aftermath, and an aftermath without completion."""
        if (self.aftermath is None) == (self.outcome == Outcome.COMPLETED):
            raise ValueError(
                f"aftermath = {self.aftermath}: must be given if and only if the outcome is "
                f"COMPLETED; the outcome is {self.outcome.name}"
            )


class _Recorder:
    """Records traces and outcomes of E roads while they are stepped."""

    def __init__(self, simulator: Simulator) -> None:
        self.simulator = simulator
        self.rows: list[NDArray[np.void]] = []
        self.maneuvers: dict[tuple[int, int], Maneuver] = {}
        self.watch = Watch(simulator)

    def before(self) -> None:
        """Record the agents that steer, and the state in which they act."""
        simulator = self.simulator
        envs, slots = np.nonzero(simulator.is_steering)
        agents = simulator.agents[envs, slots]
        cars = simulator.vehicles[envs, agents["vehicle"]]
        rows = np.zeros(envs.size, TRACE)
        rows["env"], rows["command"], rows["phase"] = envs, agents["command"], agents["phase"]
        direction = agents["direction"]
        rows["direction"], rows["speed_before"] = direction, cars["speed"]
        rows["position_before"] = cars["position"]
        rows["lateral_position_before"] = cars["lateral_position"]
        rows["deviation_before"] = self._deviation(agents, cars, agents["phase"])
        rows["yaw_before"] = direction * cars["yaw"]
        rows["yaw_rate_before"] = direction * cars["yaw_rate"]
        rows["acceleration_before"] = cars["acceleration"]
        curvature, turn_rate = road_turning(cars, simulator.parameters.arcs)
        rows["curvature"] = direction * curvature
        rows["turning_before"] = direction * (cars["yaw_rate"] - turn_rate)
        behind = agents["target_follower"]
        rows["follower_gap_before"] = self._gap(envs, cars, behind, is_ahead=False)
        without = accelerations_without_change(simulator.state, simulator.parameters)
        self._pending = rows, envs, slots
        self._without = [found[envs, slots] for found in without]
        self._vehicles = agents["vehicle"].copy(), agents["target_follower"].copy()
        # A vehicle's number is gone in the step that removes the vehicle.
        self._ids = simulator.vehicles["id"].copy()

    def after(self) -> None:
        """Complete the rows, and record the commands that ended."""
        rows, envs, slots = self._pending
        simulator = self.simulator
        agents = simulator.agents[envs, slots]
        cars = simulator.vehicles[envs, agents["vehicle"]]
        direction = agents["direction"]
        rows["step"] = simulator.roads["step"][envs]
        rows["speed"], rows["acceleration"] = cars["speed"], cars["acceleration"]
        rows["lateral_deviation"] = self._deviation(agents, cars, rows["phase"])
        for name in ("yaw", "yaw_rate", "yaw_acceleration"):
            rows[name] = direction * cars[name]
        _, turn_rate = road_turning(cars, simulator.parameters.arcs)
        rows["turning"] = direction * (cars["yaw_rate"] - turn_rate)
        target = agents["target_lane"]
        origin = agents["origin_lane"]
        rows["position"] = cars["position"]
        bodies = cars.view(np.recarray)
        rows["is_over_marking"] = _is_body_in(bodies, target)
        rows["is_in_origin"] = _is_body_in(bodies, origin)
        rows["length"] = self._length(cars)
        for side, is_ahead in (("leader", True), ("follower", False)):
            for slot, prefix in ((agents[f"target_{side}"], ""), (agents[side], "origin_")):
                others = simulator.vehicles[envs, slot]
                rows[f"{prefix}{side}_gap"] = self._gap(envs, cars, slot, is_ahead=is_ahead)
                rows[f"{prefix}{side}_speed"] = np.where(slot == NONE, np.nan, others["speed"])
            slot = agents[f"target_{side}"]
            others = simulator.vehicles[envs, slot]
            rows[f"{side}_id"] = np.where(slot == NONE, NONE, others["id"])
            if is_ahead:
                rows["leader_length"] = np.where(slot == NONE, np.nan, self._length(others))
            else:
                acceleration = np.where(slot == NONE, np.nan, others["acceleration"])
                rows["follower_acceleration"] = acceleration
        self._note_imposed(rows, envs)
        for name, values in CHANGER.terms_of(agents).items():
            rows[name] = values
        self.rows.append(rows)
        self.watch.advance()
        self._note_outcomes()

    def _note_outcomes(self) -> None:
        simulator = self.simulator
        step = simulator.scenario.time_step
        is_completed = simulator.agents["outcome"] == Outcome.COMPLETED
        envs, slots = np.nonzero(is_completed)
        begun = self.watch.begin(envs, slots)
        aftermaths = dict(zip(zip(envs.tolist(), slots.tolist(), strict=True), begun, strict=True))
        for env, slot in np.argwhere(simulator.has_ended).tolist():
            agent = simulator.agents[env, slot]
            outcome = Outcome(int(agent["outcome"]))
            born, lifetime = int(agent["born_step"]), int(simulator.roads["step"][env])
            lifetime -= born
            command = int(agent["command"])
            self.maneuvers[env, command] = Maneuver(
                env=env,
                command=command,
                vehicle=int(self._ids[env, agent["vehicle"]]),
                outcome=outcome,
                num_aborts=int(agent["num_aborts"]),
                born_step=born,
                waiting_time=lifetime * step,
                time_to_end=lifetime * step,
                has_side_collision=self._has_side_collision(env, slot, command),
                episode_reward=float(agent["episode_reward"]),
                trace=np.zeros(0, TRACE),
                aftermath=aftermaths.get((env, slot)),
            )

    def _note_imposed(self, rows: NDArray[np.void], envs: NDArray[np.int64]) -> None:
        """How much harder changer and follower brake than without the lane change."""
        for name, slot, without in zip(
            ("changer", "follower"), self._vehicles, self._without, strict=True
        ):
            driven = self.simulator.vehicles[envs, slot]["acceleration"]
            extra = np.maximum(0.0, -driven) - np.maximum(0.0, -without)
            rows[f"imposed_on_{name}"] = np.maximum(0.0, extra)

    def _has_side_collision(self, env: int, slot: int, command: int) -> bool:
        _, envs, slots = self._pending
        if not ((envs == env) & (slots == slot)).any():
            return False
        records = self.simulator.state.collisions[env]
        is_own = (records["rear_command"] == command) | (records["front_command"] == command)
        is_new = (records["rear_id"] != NONE) & (
            records["step"] == self.simulator.roads["step"][env]
        )
        return bool((is_own & is_new & (records["kind"] == CollisionKind.SIDE)).any())

    def _deviation(self, agents: Any, cars: Any, phase: Any) -> NDArray[np.float64]:
        lane = _reference_lane(phase, agents["origin_lane"], agents["target_lane"])
        centre = _lane_centre(lane, self.simulator.scenario.road.lane_width)
        return np.asarray(agents["direction"] * (centre - cars["lateral_position"]))

    def _gap(self, envs: Any, cars: Any, slot: Any, *, is_ahead: bool) -> NDArray[np.float64]:
        """Bumper to bumper, to the vehicles ahead or behind; inf if there is none."""
        others = self.simulator.vehicles[envs, slot]
        rear, front = (cars, others) if is_ahead else (others, cars)
        profiles = self.simulator.parameters.profiles.view(np.recarray)
        gap = _bumper_gap(rear.view(np.recarray), front.view(np.recarray), profiles)
        return np.where(slot == NONE, np.inf, gap)

    def _length(self, cars: Any) -> NDArray[np.float64]:
        profiles = self.simulator.parameters.profiles
        return np.asarray(2.0 * profiles["half_length"][cars["profile"]])

    def finish(self) -> list[Maneuver]:
        """The maneuvers ordered by road and command, with their traces."""
        self.watch.finish()
        rows = np.concatenate(self.rows) if self.rows else np.zeros(0, TRACE)
        rows = rows[np.lexsort((rows["step"], rows["command"], rows["env"]))]
        keys, starts = np.unique(rows[["env", "command"]], return_index=True)
        bounds = [*starts.tolist(), rows.size]
        step = self.simulator.scenario.time_step
        for index, key in enumerate(keys):
            maneuver = self.maneuvers.get((int(key["env"]), int(key["command"])))
            if maneuver is not None:
                maneuver.trace = rows[bounds[index] : bounds[index + 1]]
                first = int(maneuver.trace["step"][0])
                maneuver.waiting_time = (first - 1 - maneuver.born_step) * step
        return [self.maneuvers[key] for key in sorted(self.maneuvers)]


def run_maneuvers(
    scenario: str | Scenario,
    policy: Policy,
    num_maneuvers: int,
    *,
    seed: int = 0,
    follower_policies: Mapping[str, FollowerPolicy] | None = None,
    observe: Observe | None = None,
    progress: Callable[[int], object] | None = None,
) -> list[Maneuver]:
    """The first ``num_maneuvers`` commands of seeded episodes, ordered by road and command.

    Every road runs one whole episode of the scenario, so quick maneuvers are not counted more
    often than slow ones. Commands beyond ``num_maneuvers`` are dropped from the last road.

    Args:
        scenario: with ``num_agents`` set.
        policy: for every agent whose action is used: it steers, or waits if actions are (N, 2).
        num_maneuvers: >= 1.
        seed: of the traffic.
        follower_policies: by disposition; they have priority over registered and saved ones.
        observe: sees the roads, for example to record them; it must not change them.
        progress: called after every step with the number of finished commands.

    Raises:
        ScenarioError: its episodes have no end, no commands, or end before the first command; no
            command comes in a day of simulated time; or a disposition of its followers has no
            policy.
        CheckpointError: the checkpoint of the learned followers cannot be read or does not fit.
        ValueError: ``num_maneuvers`` is below 1, or they do not fit in memory.
    """
    if num_maneuvers < 1:
        raise ValueError(f"num_maneuvers = {num_maneuvers}: must be at least 1")
    loaded = load_scenario(scenario)
    check_memory("num_maneuvers", num_maneuvers, num_maneuvers * MANEUVER_BYTES)
    num_roads = ceil(num_maneuvers / check_episodes(loaded))
    simulator = Simulator(
        loaded, num_roads, seed=seed, follower_policies=find_policies(loaded, follower_policies)
    )
    simulator.reset()
    recorder = _Recorder(simulator)
    see = None if observe is None else observe(simulator)
    recorder.before()
    for _ in drive(simulator, policy, needs_agents=True):
        recorder.after()
        if see is not None:
            see()
        if progress is not None:
            progress(len(recorder.maneuvers))
        if simulator.roads["is_done"].all() and recorder.watch.is_over:
            break
        recorder.before()
    maneuvers = recorder.finish()[:num_maneuvers]
    if not maneuvers:
        raise ScenarioError(
            f"scenario {loaded.name!r}: horizon = {loaded.horizon}: ends before the first command"
        )
    return maneuvers


def check_episodes(scenario: Scenario) -> int:
    """The number of commands per episode, which every evaluation needs.

    Raises:
        ScenarioError: the episodes of the scenario have no end, or no commands.
    """
    if scenario.num_agents is None or scenario.command.probability == 0.0:
        raise ScenarioError(
            f"scenario {scenario.name!r}: an evaluation needs num_agents (is "
            f"{scenario.num_agents}) and command.probability > 0 (is "
            f"{scenario.command.probability})"
        )
    return scenario.num_agents
