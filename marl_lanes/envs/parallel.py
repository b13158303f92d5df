"""The PettingZoo environment: one road, an agent for every commanded vehicle."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray
from pettingzoo import AECEnv, ParallelEnv
from pettingzoo.utils.conversions import parallel_to_aec

from marl_lanes.scenario import Scenario, ScenarioError
from marl_lanes.traffic.observation import feature_bounds
from marl_lanes.traffic.simulator import Simulator
from marl_lanes.traffic.state import NONE, Outcome, Phase

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
_TERMS = ("reward_acceleration", "reward_yaw_rate", "reward_deviation", "reward_failure")
_FIELDS = ("command", "phase", "outcome", "num_aborts", "reward", *_TERMS)
_ABSENT_INFO = dict.fromkeys(("phase", "outcome", "num_aborts", *_TERMS), 0.0)

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
    the agent is engaged or aborting, clipped to the bound. Completed, collision and off-road
    terminate; a missed command (the road ends) and the horizon truncate. Infos: phase, outcome
    (codes of ``traffic.state``), num_aborts and the reward's four terms, as floats.

    Args:
        scenario: a shipped name, the path of a YAML file, a mapping or a Scenario.
        render_mode: None, the only one.
        seed: of the random numbers until ``reset(seed=...)`` gives another; without one, resets
            go on in the same stream.
        fixed_agents: every dict holds every possible agent, those absent with zeros, as TorchRL's
            PettingZooWrapper needs it; ``agents`` still lists the live ones.
        overrides: scenario fields to replace, as in ``load_scenario``.

    Raises:
        ScenarioError: the scenario cannot be, or has no end (``num_agents: null``).
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
    ) -> None:
        if render_mode is not None:
            raise ValueError(f"render_mode = {render_mode!r}: must be None")
        self.simulator = Simulator(scenario, seed=seed, num_threads=1, overrides=overrides)
        self.scenario = self.simulator.scenario
        if self.scenario.num_agents is None or self.scenario.command.probability == 0.0:
            raise ScenarioError(
                f"scenario {self.scenario.name!r}: an episode needs num_agents (is "
                f"{self.scenario.num_agents}) and command.probability > 0 (is "
                f"{self.scenario.command.probability})"
            )
        self.render_mode = render_mode
        self.fixed_agents = fixed_agents
        self.possible_agents = [f"changer_{k}" for k in range(self.scenario.num_agents)]
        self.agents: list[str] = []
        bound = self.scenario.action.max_yaw_acceleration
        low, high = feature_bounds(self.scenario.observation.features)
        self.observation_spaces = {agent: Box(low, high) for agent in self.possible_agents}
        self.action_spaces = {
            agent: Box(-bound, bound, (1,), np.float32) for agent in self.possible_agents
        }
        shape = (self.scenario.max_vehicles, len(STATE_COLUMNS))
        self.state_space = Box(-np.inf, np.inf, shape, np.float32)
        self._zeros = np.zeros(low.shape, np.float32)
        self._actions = np.zeros((1, self.simulator.num_slots, 1))
        self._slots: dict[str, int] = {}
        self._finished: set[str] = set()

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
            actions: (1,) yaw acceleration for every live agent; those of others are not used.

        Raises:
            ValueError: a live agent's action is missing, misshapen or not finite.
        """
        if not self.agents:
            return {}, {}, {}, {}, {}
        for agent in self.agents:
            self._actions[0, self._slots[agent], 0] = self._read_action(agent, actions)
        self.simulator.step(self._actions)
        result = self._absent()
        self._collect(result)
        if not self.agents and not self.simulator.roads["is_done"][0]:
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

    def _read_action(self, agent: str, actions: Mapping[str, Any]) -> float:
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
        if array.shape != (1,):
            raise ValueError(f"actions[{agent!r}] = {action!r}: must have shape (1,)")
        number = float(array[0])
        if not -np.inf < number < np.inf:
            raise ValueError(f"actions[{agent!r}] = {number}: must be finite [rad/s^2]")
        return number

    def _collect(self, result: Step) -> None:
        """Write what the live agents and those that just ended have into the dicts."""
        observations, rewards, terminations, truncations, infos = result
        seen = self.simulator.state.observations[0]
        table = self.simulator.agents[0]
        self.agents = []
        self._slots.clear()
        columns = [table[name].tolist() for name in _FIELDS]
        for slot, (command, phase, outcome, aborts, reward, *terms) in enumerate(
            zip(*columns, strict=True)
        ):
            if phase == Phase.ABSENT and outcome == Outcome.UNFINISHED:
                continue
            name = self.possible_agents[command]
            observations[name] = seen[slot].copy()
            rewards[name] = reward
            terminations[name] = outcome in _TERMINATING
            truncations[name] = outcome != Outcome.UNFINISHED and outcome not in _TERMINATING
            infos[name] = {
                "phase": float(phase),
                "outcome": float(outcome),
                "num_aborts": float(aborts),
                **dict(zip(_TERMS, terms, strict=True)),
            }
            if outcome == Outcome.UNFINISHED:
                self.agents.append(name)
                self._slots[name] = slot
            else:
                self._finished.add(name)
        self.agents.sort(key=self._order)

    def _absent(self) -> Step:
        """What the dicts say of agents that are not there: nothing, or zeros."""
        if not self.fixed_agents:
            return {}, {}, {}, {}, {}
        names = self.possible_agents
        return (
            {name: self._zeros.copy() for name in names},
            dict.fromkeys(names, 0.0),
            {name: name in self._finished for name in names},
            dict.fromkeys(names, False),
            {name: dict(_ABSENT_INFO) for name in names},
        )

    def _close_episode(self, result: Step) -> None:
        """At the horizon, the commands that were never given end as well."""
        if self.fixed_agents:
            for name in self.possible_agents:
                if name not in self._finished:
                    result[3][name] = True

    def _order(self, agent: str) -> int:
        return int(agent.removeprefix("changer_"))


def parallel_env(
    scenario: str | Path | Mapping[str, Any] | Scenario = "paper",
    render_mode: None = None,
    *,
    seed: int = 0,
    fixed_agents: bool = False,
    overrides: Mapping[str, Any] | None = None,
) -> LaneChangeParallelEnv:
    """The parallel environment; arguments as for ``LaneChangeParallelEnv``."""
    return LaneChangeParallelEnv(
        scenario, render_mode, seed=seed, fixed_agents=fixed_agents, overrides=overrides
    )


def env(
    scenario: str | Path | Mapping[str, Any] | Scenario = "paper",
    render_mode: None = None,
    *,
    seed: int = 0,
    overrides: Mapping[str, Any] | None = None,
) -> AECEnv:
    """The same environment in PettingZoo's agent-environment-cycle form."""
    return parallel_to_aec(parallel_env(scenario, render_mode, seed=seed, overrides=overrides))
