"""Observations of a few units and actions from -1 to 1, for PettingZoo's learners."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray
from pettingzoo import ParallelEnv
from pettingzoo.utils import BaseParallelWrapper

from marl_lanes.envs.actions import check_actions, read_action, scale_action
from marl_lanes.envs.closing import Closes
from marl_lanes.envs.fit import network_form
from marl_lanes.envs.infos import Step


class Normalised(Closes, BaseParallelWrapper):
    """The features less their offsets, divided by their scales; actions as parts of their bounds.

    A feature is a few units at most in ordinary traffic; its bounds are far beyond. An action of 0
    is 0: drive straight on, keep the speed. 1 is the upper bound, -1 the lower one, which may be
    further from 0 (braking), so the scaling has a kink at 0. Offsets and scales are those of
    ``Role.seen(scenario)``, as for the package's own networks.

    Args:
        env: a ``LaneChangeParallelEnv``.
    """

    def __init__(self, env: ParallelEnv) -> None:
        super().__init__(env)
        self._forms = {}
        for role in env.simulator.roles:
            form = network_form(role, env.scenario)
            keys = ("offsets", "scales", "action_low", "action_high")
            self._forms[role.name] = [np.asarray(form[key]) for key in keys]
        self.observation_spaces, self.action_spaces = {}, {}
        for agent in env.possible_agents:
            space = env.observation_space(agent)
            low, high = (self._scaled(agent, bound) for bound in (space.low, space.high))
            self.observation_spaces[agent] = Box(low, high)
            self.action_spaces[agent] = Box(-1.0, 1.0, env.action_space(agent).shape)

    def observation_space(self, agent: str) -> Box:
        """The same space object at every call."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Box:
        """The same space object at every call."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[dict[str, NDArray[np.float32]], dict[str, dict[str, float]]]:
        """Start an episode, as ``LaneChangeParallelEnv.reset``."""
        seen, infos = self.env.reset(seed=seed, options=options)
        return {agent: self._scaled(agent, row) for agent, row in seen.items()}, infos

    def step(self, actions: Mapping[str, Any]) -> Step:
        """Advance as ``LaneChangeParallelEnv.step``; actions beyond [-1, 1] are clipped."""
        check_actions(actions)
        scaled = {}
        for agent in set(self.env.agents) & set(actions):
            _, _, low, high = self._form_of(agent)
            scaled[agent] = scale_action(read_action(agent, actions[agent], len(low)), low, high)
        seen, *others = self.env.step(scaled)
        return {agent: self._scaled(agent, row) for agent, row in seen.items()}, *others

    def _form_of(self, agent: str) -> list[NDArray[np.float64]]:
        return self._forms[agent.rpartition("_")[0]]

    def _scaled(self, agent: str, row: NDArray[np.float32]) -> NDArray[np.float32]:
        offsets, scales, _, _ = self._form_of(agent)
        return ((row - offsets) / scales).astype(np.float32)
