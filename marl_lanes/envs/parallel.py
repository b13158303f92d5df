"""The PettingZoo environment: one road, one agent per commanded vehicle."""

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium import logger
from gymnasium.spaces import Box
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from marl_lanes.envs.actions import check_actions, read_action
from marl_lanes.envs.closing import Closes
from marl_lanes.envs.episodes import check_spaces, count_agents
from marl_lanes.envs.followers import find_policies
from marl_lanes.envs.infos import Step
from marl_lanes.envs.options import read_options
from marl_lanes.envs.step_reader import StepReader
from marl_lanes.envs.vehicle_table import read_vehicle_table, state_bounds
from marl_lanes.scenario import Scenario, ScenarioError, load_scenario
from marl_lanes.scenario.messages import shown
from marl_lanes.traffic.arguments import check_flag, check_whole
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.traffic.roles.external import FollowerPolicy
from marl_lanes.traffic.simulator import Simulator

if TYPE_CHECKING:
    from marl_lanes.envs.rendering import Renderer, View

MAX_SKIPPED = 1000
"""Episodes without a command that a reset skips before it gives up."""


class LaneChangeParallelEnv(Closes, ParallelEnv):
    """Lane changes as a PettingZoo parallel environment.

    An episode ends when the ``num_agents`` commands of the scenario are finished, or at its
    horizon; ``reset`` skips those that end before the first command. ``changer_k`` is the vehicle
    of the k-th command, from the command to its outcome; each name is used once per episode. While
    no agent is live, reset and step advance the traffic, so ``agents`` is empty only at the end of
    the episode.

    Observation: the scenario's features in its order, (F,) float32, SI units, in the maneuver frame
    (positive toward the target lane). Action: yaw acceleration, (1,) float32 [rad/s^2], used while
    the agent is engaged or aborting, clipped to the bound; with ``action.longitudinal`` (2,), the
    second the longitudinal acceleration [m/s^2], used while the agent is live. Completed, collision
    and off_road terminate; missed (the road ends), timed_out and horizon truncate. Infos: phase,
    outcome (codes of ``Outcome``), num_aborts and the reward terms, as floats.

    With ``learned_followers``, ``follower_k`` is the driver behind changer_k in its target lane,
    live as long as changer_k. Its action, the longitudinal acceleration (1,) [m/s^2], is used while
    the two are paired: changer_k is engaged and such a driver exists (``is_paired`` in its info).
    Observation: FOLLOWER_COLUMNS, (G,) float32, zeros if no vehicle is behind.

    Args:
        scenario: a shipped name, the path of a YAML file, a mapping or a Scenario.
        render_mode: None; "rgb_array": ``render`` returns a picture; "human": reset and step show
            the road in a window, at ``render_fps``, also the time in which no agent is live.
        seed: of the random numbers, 0 to 2^64 - 1, until ``reset(seed=...)`` sets another; a reset
            without a seed continues the stream. None: drawn from the system's entropy.
        overrides: scenario fields to replace, as in ``load_scenario``.
        learned_followers: followers are agents, too: the drivers with the disposition ``learned``,
            or all drivers if the mix has no ``learned``.
        follower_policies: policies by their name in ``followers.mix``; they have priority over
            registered ones.
        max_cycles: steps after which an episode is truncated, >= 1; None: it has no such limit.
        has_flat_state: ``state`` is a vector, row by row.
        view: how the road is shown, ``ViewOptions`` or a mapping of its fields; not used where
            render_mode is None.

    Attributes:
        state_space: of ``state``.
        metadata: PettingZoo's; ``render_fps`` is the number of time steps in a second.

    Raises:
        ScenarioError: the scenario is invalid, has no end (``num_agents: null``), or a follower of
            its mix has no policy.
        CheckpointError: the checkpoint of the learned follower cannot be used.
        MissingExtraError: render_mode needs the extra ``view``, which is not installed.
        ValueError: another argument has a wrong type, or is out of range.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - PettingZoo reads it off the class
        "name": "lane_change_v0",
        "render_modes": ["human", "rgb_array"],
        "render_fps": 1.0 / Scenario.model_fields["time_step"].default,
        "is_parallelizable": True,
    }

    def __init__(
        self,
        scenario: str | Path | Mapping[str, Any] | Scenario = "paper",
        render_mode: str | None = None,
        *,
        seed: int | None = None,
        overrides: Mapping[str, Any] | None = None,
        learned_followers: bool = False,
        follower_policies: Mapping[str, FollowerPolicy] | None = None,
        max_cycles: int | None = None,
        has_flat_state: bool = False,
        view: "View" = None,
    ) -> None:
        modes = self.metadata["render_modes"]
        if render_mode is not None and render_mode not in modes:
            raise ValueError(f"render_mode = {shown(render_mode)}: must be None or one of {modes}")
        if max_cycles is not None:
            max_cycles = check_whole("max_cycles", max_cycles, 1, sys.maxsize)
        self._max_cycles, self._num_cycles = max_cycles, 0
        self._has_flat_state = check_flag("has_flat_state", has_flat_state)
        self._learned_followers, self._policies = learned_followers, follower_policies
        self._is_seeded = seed is not None
        self._generator: tuple[int, np.random.Generator] | None = None
        self.simulator = self._make_simulator(load_scenario(scenario, overrides), seed)
        self.scenario = self._made = self.simulator.scenario
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": 1.0 / self.scenario.time_step}
        self._chosen_view = view
        self._renderer = self._make_renderer()
        self.agents: list[str] = []
        num_agents = count_agents(self.scenario)
        self._names = {
            role.name: [f"{role.name}_{k}" for k in range(num_agents)]
            for role in self.simulator.roles
        }
        self._role_of = {
            agent: role for role in self.simulator.roles for agent in self._names[role.name]
        }
        self.possible_agents = list(self._role_of)
        self.observation_spaces = {}
        self.action_spaces = {}
        for agent, role in self._role_of.items():
            self.observation_spaces[agent] = Box(*role.observation_bounds(self.scenario))
            self.action_spaces[agent] = Box(*role.action_bounds(self.scenario))
        low, high = state_bounds(self.scenario, num_agents)
        if self._has_flat_state:
            low, high = low.ravel(), high.ravel()
        self.state_space = Box(low, high)
        self._reader = StepReader(self.simulator, self._names)

    def _make_simulator(self, scenario: Scenario, seed: int | None) -> Simulator:
        policies = find_policies(scenario, self._policies, has_learner=self._learned_followers)
        return Simulator(
            scenario,
            seed=seed,
            num_threads=1,
            learned_followers=self._learned_followers,
            follower_policies=policies,
        )

    def _find_traffic(self, changes: Mapping[str, Any]) -> Simulator:
        """The last simulator, or another for the changes, with the random numbers of the last."""
        changed = load_scenario(self._made, changes)
        if changed == self.scenario:
            return self.simulator
        check_spaces(changed, self._made, self.simulator.roles)
        simulator = self._make_simulator(changed, 0)
        for name in ("random_key", "random_stream", "random_counter"):
            simulator.roads[name] = self.simulator.roads[name]
        return simulator

    def _use_traffic(self, simulator: Simulator) -> None:
        self.simulator, self.scenario = simulator, simulator.scenario
        self._reader = StepReader(simulator, self._names)
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = self._make_renderer()

    def _make_renderer(self) -> "Renderer | None":
        if self.render_mode is None:
            return None
        # Imported here, because an environment that shows nothing needs none of it.
        from marl_lanes.envs.rendering import Renderer

        has_window = self.render_mode == "human"
        return Renderer(self.simulator, 0, self._chosen_view, has_window=has_window)

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        if not self._is_seeded:
            # Vector environments copy one that has not been used: their traffic must differ.
            self.simulator.seed()

    @property
    def initial_seed(self) -> int:
        """The seed with which the present random numbers began, given or drawn."""
        return self.simulator.initial_seed

    @property
    def np_random(self) -> np.random.Generator:
        """A generator with the same seed, for wrappers; the traffic has its own random numbers."""
        if self._generator is None or self._generator[0] != self.initial_seed:
            self._generator = self.initial_seed, np.random.default_rng(self.initial_seed)
        return self._generator[1]

    @property
    def is_cut(self) -> bool:
        """Whether the episode has ended before all its commands: by its horizon or max_cycles."""
        road = self.simulator.roads[0]
        return not self.agents and bool(road["is_cut"] or not road["is_done"])

    def observation_space(self, agent: str) -> Box:
        """The same space object at every call."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Box:
        """The same space object at every call."""
        return self.action_spaces[agent]

    def reset(
        self,
        seed: int | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> tuple[dict[str, NDArray[np.float32]], dict[str, dict[str, float]]]:
        """Start an episode: warm up the traffic and advance to the first command.

        Args:
            seed: 0 to 2^64 - 1; None continues the stream of the last seed.
            options: ``overrides``: scenario fields to replace in this episode, as in
                ``load_scenario``; observation, action, num_agents, max_vehicles and time_step must
                stay. ``snapshot``: begin in this state, of ``simulator.snapshot()``, in which an
                agent is live. Unknown ones are refused.

        Raises:
            DisplayError: render_mode is "human", and there is no display.
            ScenarioError: MAX_SKIPPED episodes in a row ended before the first command, or the
                overrides are not valid.
            ValueError: the seed is out of range, or the options are not valid.
        """
        chosen = read_options(options)
        simulator = self._find_traffic(chosen.overrides or {})
        if seed is not None:
            simulator.seed(seed)
            self._generator = None
        self._is_seeded, self._num_cycles = True, 0
        if simulator is not self.simulator:
            self._use_traffic(simulator)
        if self._renderer is not None:
            self._renderer.open()
        self._begin(chosen.snapshot)
        result: Step = ({}, {}, {}, {}, {})
        self.agents = self._reader.read(result)
        if self._renderer is not None:
            self._renderer.show()
        for name in set(result[4]) - set(self.agents):
            # Its command ended in the last step before the snapshot.
            del result[0][name], result[4][name]
        return result[0], result[4]

    def step(self, actions: Mapping[str, Any]) -> Step:
        """Advance one time step, and further until an agent is live or the episode is over.

        Args:
            actions: for every live agent, D numbers for a changer, one for a follower, in any
                shape; actions of other agents are ignored.

        Raises:
            ValueError: the action of a live agent is missing, not finite, or has a wrong size.
        """
        if not self.agents:
            return {}, {}, {}, {}, {}
        check_actions(actions)
        values = [self._read_action(agent, actions) for agent in self.agents]
        simulator = self.simulator
        for agent, value in zip(self.agents, values, strict=True):
            is_changer = self._role_of[agent] is CHANGER
            buffer = simulator.actions if is_changer else simulator.follower_actions
            buffer[0, self._reader.slots[agent]] = value
        if self._renderer is not None:
            self._renderer.note()
        simulator.advance()
        result: Step = ({}, {}, {}, {}, {})
        self.agents = self._reader.read(result)
        if not self.agents and not self._reader.is_done[0]:
            # The agents that have just ended stay in the dicts; new ones are added.
            self._advance_until_live()
            self.agents = self._reader.read(result)
        self._num_cycles += 1
        if self._num_cycles == self._max_cycles:
            result[3].update(dict.fromkeys(self.agents, True))
            self.agents = []
        if self._renderer is not None:
            self._renderer.show()
        return result

    def render(self) -> NDArray[np.uint8] | None:
        """The road as it is now.

        Returns:
            (H, W, 3) uint8 if render_mode is "rgb_array"; the same bytes until the next step.
            None if it is "human", where reset and step show the road, or None, with a warning.
        """
        if self._renderer is None:
            logger.warn(
                "You are calling render method without specifying any render mode. Make the "
                'environment with render_mode="rgb_array" or "human".'
            )
            return None
        if self.render_mode == "human":
            self._renderer.attend()
            return None
        return self._renderer.render()

    def state(self) -> NDArray[np.float32]:
        """Every vehicle on the road by decreasing position, (max_vehicles, columns) float32.

        The columns are ``state_columns``, clipped to the bounds of ``state_space``; rows without a
        vehicle are zero, with agent -1. With ``has_flat_state`` (max_vehicles * columns,).
        """
        rows = read_vehicle_table(self.simulator)
        return rows.ravel() if self._has_flat_state else rows

    def close(self) -> None:
        """Close the window for good; the environment can be used on, unshown."""
        if self._renderer is not None:
            self._renderer.close()

    def _begin(self, snapshot: bytes | None) -> None:
        """Reset the road until an agent is live, or continue from a snapshot."""
        self.agents = []
        if snapshot is not None:
            self.simulator.restore(snapshot)
            if self._renderer is not None:
                self._renderer.restart()
            self._advance_until_live()
            if not self.simulator.roads["num_live"][0]:
                raise ValueError("options['snapshot']: an agent must become live, none does")
            return
        for _ in range(MAX_SKIPPED):
            self.simulator.reset()
            if self._renderer is not None:
                self._renderer.restart()
            self._advance_until_live()
            if self.simulator.roads["num_live"][0]:
                return
        raise ScenarioError(
            f"scenario {self.scenario.name!r}: horizon = {self.scenario.horizon}: must be longer, "
            f"no command came in {MAX_SKIPPED} episodes"
        )

    def _advance_until_live(self) -> None:
        """Advance until an agent is live or the episode is over; an open window shows it."""
        renderer, road = self._renderer, self.simulator.roads
        if renderer is not None:
            while renderer.is_open and not (road["num_live"][0] or road["is_done"][0]):
                renderer.show()
                renderer.note()
                self.simulator.advance()
        self.simulator.advance_until_live()

    def _read_action(self, agent: str, actions: Mapping[str, Any]) -> NDArray[np.floating[Any]]:
        try:
            action = actions[agent]
        except KeyError:
            raise ValueError(
                f"actions: {agent} is live and has no action; live agents: {self.agents}"
            ) from None
        return read_action(agent, action, self.action_spaces[agent].shape[0])
