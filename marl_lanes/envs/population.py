"""A constant population: every possible agent takes part until the episode's end."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray
from pettingzoo import ParallelEnv
from pettingzoo.utils import BaseParallelWrapper

from marl_lanes.envs.actions import check_actions
from marl_lanes.envs.closing import Closes
from marl_lanes.envs.infos import Step, info_names
from marl_lanes.traffic.machine.state import Outcome
from marl_lanes.traffic.roles.changer import CHANGER

_CUT = {float(Outcome.UNFINISHED), float(Outcome.HORIZON)}
"""Outcomes of a changer whose episode ends, and not its command."""


class ConstantPopulation(Closes, BaseParallelWrapper):
    """For learners whose number of agents is fixed: SuperSuit, Stable-Baselines3, and others.

    ``agents`` lists every possible agent until the episode's end, and so does every dict. An
    observation has three more columns at its end, of which one is 1 and the others 0: ``is_unborn``
    (no command yet), ``is_live``, ``has_ended``. The rest of an agent that is not live is zeros;
    its action is ignored. It is neither terminated nor truncated before the episode's end: then
    all agents are, truncated if the horizon or ``max_cycles`` was the end; whoever was live until
    then still is in the last observation, from which learners bootstrap. So a row is a valid
    transition if its observation was live. Infos have ``is_live``, too; the step in which an agent
    ends has its reward and its info.

    Args:
        env: a ``LaneChangeParallelEnv``, or a wrapper of it.
    """

    def __init__(self, env: ParallelEnv) -> None:
        super().__init__(env)
        self.agents: list[str] = []
        self.observation_spaces = {}
        for agent in env.possible_agents:
            space = env.observation_space(agent)
            low, high = np.append(space.low, [0] * 3), np.append(space.high, [1] * 3)
            self.observation_spaces[agent] = Box(np.float32(low), np.float32(high))
        self._absent = {name: dict.fromkeys(info_names(name), 0.0) for name in env.possible_agents}
        self._live: set[str] = set()
        self._ended: set[str] = set()

    def observation_space(self, agent: str) -> Box:
        """The same space object at every call."""
        return self.observation_spaces[agent]

    def reset(
        self, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[dict[str, NDArray[np.float32]], dict[str, dict[str, float]]]:
        """Start an episode, as ``LaneChangeParallelEnv.reset``."""
        seen, infos = self.env.reset(seed=seed, options=options)
        self._live = set(self.env.agents)
        # In a snapshot commands may be over.
        count = int(self.env.simulator.roads["num_commands"][0])
        begun = {name for name in self.possible_agents if int(_number_of(name)) < count}
        self._ended = begun - self._live
        self.agents = list(self.possible_agents)
        return self._observe(seen), self._tell(infos)

    def step(self, actions: Mapping[str, Any]) -> Step:
        """Advance as ``LaneChangeParallelEnv.step``, with every agent in every dict."""
        if not self.agents:
            return {}, {}, {}, {}, {}
        check_actions(actions)
        live = {agent: actions[agent] for agent in self.env.agents if agent in actions}
        seen, rewards, terminations, truncations, infos = self.env.step(live)
        names = self.agents
        is_over, is_cut = not self.env.agents, self.env.is_cut
        over = {name for name in infos if terminations[name] or truncations[name]}
        cut = {name for name in over if is_cut and _outcome_of(name, infos) in _CUT}
        self._live = set(self.env.agents) | cut
        self._ended |= over - cut
        self.agents = [] if is_over else list(names)
        return (
            self._observe(seen),
            {name: rewards.get(name, 0.0) for name in names},
            dict.fromkeys(names, is_over and not is_cut),
            dict.fromkeys(names, is_over and is_cut),
            self._tell(infos),
        )

    def _observe(self, seen: Mapping[str, NDArray[np.float32]]) -> dict[str, NDArray[np.float32]]:
        observations = {}
        for name in self.possible_agents:
            row = np.zeros(self.observation_spaces[name].shape, np.float32)
            is_live, has_ended = name in self._live, name in self._ended
            if is_live:
                row[:-3] = seen[name]
            row[-3:] = not (is_live or has_ended), is_live, has_ended
            observations[name] = row
        return observations

    def _tell(self, infos: Mapping[str, Mapping[str, float]]) -> dict[str, dict[str, float]]:
        return {
            name: {**infos.get(name, absent), "is_live": float(name in self._live)}
            for name, absent in self._absent.items()
        }


def _outcome_of(name: str, infos: Mapping[str, Mapping[str, float]]) -> float:
    """Of the changer, or of the one whose follower it is."""
    return infos[f"{CHANGER.name}_{_number_of(name)}"]["outcome"]


def _number_of(name: str) -> str:
    return name.rpartition("_")[2]
