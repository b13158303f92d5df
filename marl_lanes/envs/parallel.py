"""The PettingZoo environment: one road, an agent for every commanded vehicle."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypedDict, Unpack

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray
from pettingzoo import AECEnv, ParallelEnv
from pettingzoo.utils.conversions import parallel_to_aec

from marl_lanes.envs.followers import find_policies
from marl_lanes.scenario import Scenario, ScenarioError, load_scenario
from marl_lanes.traffic.machine.state import NONE, Outcome, Phase
from marl_lanes.traffic.parameters import action_bounds, follower_action_bounds
from marl_lanes.traffic.roles.external import FollowerPolicy
from marl_lanes.traffic.roles.observation import feature_bounds, follower_feature_bounds
from marl_lanes.traffic.simulator import Simulator

STATE_COLUMNS = (
    "position",
    "lateral_position",
    "speed",
    "acceleration",
    "yaw",
    "yaw_rate",
    "agent",
)
"""Columns of ``state()``: fields of the vehicle table; ``agent`` is the serial number of its
command, -1 without one."""

_TERMINATING = {int(Outcome.COMPLETED), int(Outcome.COLLISION), int(Outcome.OFF_ROAD)}
_TERMS = (
    "reward_acceleration",
    "reward_yaw_rate",
    "reward_deviation",
    "reward_failure",
    "reward_delay",
    "reward_longitudinal",
)
_FOLLOWER_TERMS = (
    "reward_delay",
    "reward_abort",
    "reward_collision",
    "reward_discomfort",
    "reward_braking",
)
_INFO = ("phase", "outcome", "num_aborts", *_TERMS)
_FOLLOWER_INFO = ("phase", "is_paired", *_FOLLOWER_TERMS)

_ABSENT = int(Phase.ABSENT)
_UNFINISHED = int(Outcome.UNFINISHED)


class Options(TypedDict, total=False):
    """The keyword arguments of ``LaneChangeParallelEnv``, where they are explained."""

    seed: int
    fixed_agents: bool
    overrides: Mapping[str, Any] | None
    learned_followers: bool
    follower_policies: Mapping[str, FollowerPolicy] | None


Step = tuple[
    dict[str, NDArray[np.float32]],
    dict[str, float],
    dict[str, bool],
    dict[str, bool],
    dict[str, dict[str, float]],
]


class LaneChangeParallelEnv(ParallelEnv):
    """Lane changes as a PettingZoo parallel environment.

    An episode is the scenario's ``num_agents`` commands, all born and finished, or its horizon.
    ``changer_k`` is the vehicle of the k-th command, from the command to its outcome; each name is
    used once an episode. Reset and step run the traffic on until an agent is live, so ``agents`` is
    empty only when the episode is over.

    Observation: the scenario's features in its order, (F,) float32, SI units, in the maneuver frame
    (positive toward the target lane). Action: yaw acceleration, (1,) float32 [rad/s^2], used while
    the agent is engaged or aborting, clipped to the bound; with ``action.longitudinal`` (2,), the
    second the longitudinal acceleration [m/s^2], used while it is live. Completed, collision and
    off-road terminate; a missed command (the road ends) and the horizon truncate. Infos: phase,
    outcome (codes of ``traffic.state``), num_aborts and the reward's terms, as floats.

    With ``learned_followers``, ``follower_k`` is the driver behind changer_k in its target lane,
    live as long as changer_k. Its action, the longitudinal acceleration (1,) [m/s^2], is used while
    the two are paired: changer_k is engaged and such a driver exists (``is_paired`` in its info).
    Observation: FOLLOWER_FEATURES, (G,) float32, zeros where nobody is behind.

    Args:
        scenario: a shipped name, the path of a YAML file, a mapping or a Scenario.
        render_mode: None, the only one.
        seed: of the random numbers until ``reset(seed=...)`` gives another; without one, resets
            go on in the same stream.
        fixed_agents: every dict holds every possible agent, those absent with zeros, as TorchRL's
            PettingZooWrapper needs it; ``agents`` still lists the live ones.
        overrides: scenario fields to replace, as in ``load_scenario``.
        learned_followers: followers are agents too: those whose disposition is ``learned``, or all
            where the mix has none of these.
        follower_policies: policies by their name in ``followers.mix``, before registered ones.

    Raises:
        ScenarioError: the scenario cannot be, has no end (``num_agents: null``), or a follower of
            its mix has no policy.
        CheckpointError: the checkpoint of the learned follower cannot be used.
        ValueError: another argument is out of range.
    """

    metadata = {  # noqa: RUF012 - PettingZoo reads it off the class
        "name": "lane_change_v0",
        "render_modes": [],
        "is_parallelizable": True,
    }

    def __init__(
        self,
        scenario: str | Path | Mapping[str, Any] | Scenario = "paper",
        render_mode: None = None,
        *,
        seed: int = 0,
        fixed_agents: bool = False,
        overrides: Mapping[str, Any] | None = None,
        learned_followers: bool = False,
        follower_policies: Mapping[str, FollowerPolicy] | None = None,
    ) -> None:
        if render_mode is not None:
            raise ValueError(f"render_mode = {render_mode!r}: must be None")
        loaded = load_scenario(scenario, overrides)
        self.simulator = Simulator(
            loaded,
            seed=seed,
            num_threads=1,
            learned_followers=learned_followers,
            follower_policies=find_policies(
                loaded, follower_policies, has_learner=learned_followers
            ),
        )
        self.scenario = self.simulator.scenario
        if self.scenario.num_agents is None or self.scenario.command.probability == 0.0:
            raise ScenarioError(
                f"scenario {self.scenario.name!r}: an episode needs num_agents (is "
                f"{self.scenario.num_agents}) and command.probability > 0 (is "
                f"{self.scenario.command.probability})"
            )
        self.render_mode = render_mode
        self.fixed_agents = fixed_agents
        self.agents: list[str] = []
        self.groups = ("changer", "follower") if learned_followers else ("changer",)
        self.possible_agents = [
            f"{group}_{k}" for group in self.groups for k in range(self.scenario.num_agents)
        ]
        self._rank = {agent: rank for rank, agent in enumerate(self.possible_agents)}
        bounds = {
            "changer": (
                feature_bounds(self.scenario.observation.features),
                action_bounds(self.scenario),
            ),
            "follower": (follower_feature_bounds(), follower_action_bounds(self.scenario)),
        }
        self.observation_spaces = {}
        self.action_spaces = {}
        for agent in self.possible_agents:
            seen, acted = bounds[agent.partition("_")[0]]
            self.observation_spaces[agent] = Box(*seen)
            self.action_spaces[agent] = Box(*acted)
        shape = (self.scenario.max_vehicles, len(STATE_COLUMNS))
        self.state_space = Box(-np.inf, np.inf, shape, np.float32)
        self._slots: dict[str, int] = {}
        self._finished: set[str] = set()
        self._view()

    def _view(self) -> None:
        """Views of the road: taking them at every step would be a good part of its time."""
        state = self.simulator.state
        table = state.agents[0]
        self._seen, self._is_done = state.observations[0], state.roads["is_done"]
        self._phases, self._outcomes = table["phase"], table["outcome"]
        self._commands, self._rewards = table["command"], table["reward"]
        self._info = [table[name] for name in _INFO]

    def __setstate__(self, state: dict[str, Any]) -> None:
        # A copy's views must be of its own road.
        self.__dict__.update(state)
        self._view()

    def observation_space(self, agent: str) -> Box:
        """The same space object at every call."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Box:
        """The same space object at every call."""
        return self.action_spaces[agent]

    def reset(
        self,
        seed: int | None = None,
        options: Mapping[str, Any] | None = None,  # noqa: ARG002 - PettingZoo passes it
    ) -> tuple[dict[str, NDArray[np.float32]], dict[str, dict[str, float]]]:
        """Start an episode on traffic that has run its warm-up, at its first command.

        Args:
            seed: 0 to 2^64 - 1; None goes on in the stream of the last one.
            options: not used.
        """
        if seed is not None:
            self.simulator.seed(seed)
        self.simulator.reset()
        self.simulator.advance_until_live()
        self._finished.clear()
        self._slots = {}
        result = self._absent()
        self._collect(result)
        return result[0], result[4]

    def step(self, actions: Mapping[str, Any]) -> Step:
        """Advance one time step, and on until an agent is live or the episode is over.

        Args:
            actions: (D,) or, for followers, (1,) for every live agent; those of others are not
                used.

        Raises:
            ValueError: a live agent's action is missing, misshapen or not finite.
        """
        if not self.agents:
            return {}, {}, {}, {}, {}
        values = [self._read_action(agent, actions) for agent in self.agents]
        simulator = self.simulator
        for agent, value in zip(self.agents, values, strict=True):
            is_changer = agent.startswith("changer")
            buffer = simulator.actions if is_changer else simulator.follower_actions
            buffer[0, self._slots[agent]] = value
        simulator.advance()
        result = self._absent()
        self._collect(result)
        if not self.agents and not self._is_done[0]:
            # The agents that just ended stay in the dicts; newborn ones join them.
            self.simulator.advance_until_live()
            self._collect(result)
        if not self.agents:
            self._close_episode(result)
        return result

    def state(self) -> NDArray[np.float32]:
        """Every vehicle on the road by decreasing position, (max_vehicles, columns) float32.

        The columns are STATE_COLUMNS; rows without a vehicle are zero, their agent -1.
        """
        rows = np.zeros(self.state_space.shape, np.float32)
        count = int(self.simulator.roads["num_vehicles"][0])
        cars = self.simulator.vehicles[0, self.simulator.state.order[0, :count]]
        for column, name in enumerate(STATE_COLUMNS[:-1]):
            rows[:count, column] = cars[name]
        commands = self.simulator.agents["command"][0, cars["agent"]]
        rows[:count, -1] = np.where(cars["agent"] == NONE, NONE, commands)
        rows[count:, -1] = NONE
        return rows

    def close(self) -> None:
        """Nothing to release."""

    def _read_action(self, agent: str, actions: Mapping[str, Any]) -> list[float]:
        try:
            action = actions[agent]
        except KeyError:
            raise ValueError(
                f"actions: {agent} is live and has no action; live are {self.agents}"
            ) from None
        try:
            array = np.asarray(action, np.float64)
        except (TypeError, ValueError, OverflowError) as error:
            raise ValueError(f"actions[{agent!r}] = {action!r}: {error}") from None
        shape = self.action_spaces[agent].shape
        if array.shape != shape:
            raise ValueError(f"actions[{agent!r}] = {action!r}: must have shape {shape}")
        values: list[float] = array.tolist()
        if not all(map(math.isfinite, values)):
            raise ValueError(f"actions[{agent!r}] = {values}: must be finite [rad/s^2, m/s^2]")
        return values

    def _collect(self, result: Step) -> None:
        """Write what the live agents and those that just ended have into the dicts."""
        observations, rewards, terminations, truncations, infos = result
        self.agents = []
        self._slots.clear()
        phases, outcomes = self._phases.tolist(), self._outcomes.tolist()
        for slot, (phase, outcome) in enumerate(zip(phases, outcomes, strict=True)):
            is_over = outcome != _UNFINISHED
            if phase == _ABSENT and not is_over:
                continue
            command = self._commands.item(slot)
            name = self.possible_agents[command]
            terminations[name] = outcome in _TERMINATING
            truncations[name] = is_over and outcome not in _TERMINATING
            observations[name] = self._seen[slot].copy()
            rewards[name] = self._rewards.item(slot)
            values = [float(column.item(slot)) for column in self._info]
            infos[name] = dict(zip(_INFO, values, strict=True))
            both = [name]
            if len(self.groups) > 1:
                both.append(f"follower_{command}")
                self._collect_follower(slot, name, result)
            if is_over:
                self._finished.update(both)
            else:
                self.agents += both
                self._slots.update(dict.fromkeys(both, slot))
        self.agents.sort(key=self._rank.__getitem__)

    def _collect_follower(self, slot: int, changer: str, result: Step) -> None:
        """Write what the driver behind the changer of a slot has into the dicts."""
        observations, rewards, terminations, truncations, infos = result
        name = changer.replace("changer", "follower")
        record = self.simulator.state.followers[0, slot]
        observations[name] = self.simulator.state.follower_observations[0, slot].copy()
        rewards[name] = float(record["reward"])
        terminations[name], truncations[name] = terminations[changer], truncations[changer]
        infos[name] = {
            "phase": infos[changer]["phase"],
            "is_paired": float(self.simulator.is_follower_acting[0, slot]),
            **{term: float(record[term]) for term in _FOLLOWER_TERMS},
        }

    def _absent(self) -> Step:
        """What the dicts say of agents that are not there: nothing, or zeros."""
        if not self.fixed_agents:
            return {}, {}, {}, {}, {}
        names = self.possible_agents
        return (
            {name: np.zeros(self.observation_spaces[name].shape, np.float32) for name in names},
            dict.fromkeys(names, 0.0),
            {name: name in self._finished for name in names},
            dict.fromkeys(names, False),
            {
                name: dict.fromkeys(_INFO if name.startswith("changer") else _FOLLOWER_INFO, 0.0)
                for name in names
            },
        )

    def _close_episode(self, result: Step) -> None:
        """At the horizon, the commands that were never given end as well."""
        if self.fixed_agents:
            for name in self.possible_agents:
                if name not in self._finished:
                    result[3][name] = True


def parallel_env(
    scenario: str | Path | Mapping[str, Any] | Scenario = "paper",
    render_mode: None = None,
    **options: Unpack[Options],
) -> LaneChangeParallelEnv:
    """The parallel environment; arguments as for ``LaneChangeParallelEnv``."""
    return LaneChangeParallelEnv(scenario, render_mode, **options)


def env(
    scenario: str | Path | Mapping[str, Any] | Scenario = "paper",
    render_mode: None = None,
    **options: Unpack[Options],
) -> AECEnv:
    """The same environment in PettingZoo's agent-environment-cycle form."""
    return parallel_to_aec(parallel_env(scenario, render_mode, **options))
