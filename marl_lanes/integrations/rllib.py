"""An environment of RLlib's new API stack, in which agents are born and end within an episode."""

from collections.abc import Mapping
from typing import Any

from ray.rllib.env.multi_agent_env import MultiAgentEnv

from marl_lanes.envs.forms import parallel_env


class LaneChangeMultiAgentEnv(MultiAgentEnv):
    """The parallel environment, normalised unless the config says otherwise.

    RLlib ends an episode when every agent that it has seen is done, also where one is born in that
    step. So that no life is lost, its episode ends there, and the next one goes on with the same
    road: a reset without a seed or options begins with those that were born. The road's own
    episode ends as it does elsewhere, and the next reset begins another one.

    Args:
        config: RLlib's ``env_config``: arguments of ``parallel_env``. Give no seed there: every
            worker would have the same traffic; RLlib seeds the workers by ``debugging(seed=...)``.
    """

    def __init__(self, config: Mapping[str, Any] | None = None) -> None:
        super().__init__()
        self.env = parallel_env(**{"normalised": True, **(config or {})})
        self.possible_agents: list[Any] = self.env.possible_agents
        self.agents: list[Any] = []
        self._born: tuple[dict[Any, Any], dict[Any, Any]] = ({}, {})
        self.observation_spaces = {a: self.env.observation_space(a) for a in self.possible_agents}
        self.action_spaces = {a: self.env.action_space(a) for a in self.possible_agents}

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[dict[Any, Any], dict[Any, Any]]:
        """Start an episode, or go on with those that were born when the last one ended."""
        observations, infos = self._born
        if seed is not None or options or not observations:
            observations, infos = self.env.reset(seed=seed, options=options or None)
        self._born = ({}, {})
        self.agents = list(self.env.agents)
        return observations, infos

    # RLlib's own method differs from that of gymnasium's class, too.
    def step(  # type: ignore[override]
        self, action_dict: dict[Any, Any]
    ) -> tuple[dict[Any, Any], dict[Any, Any], dict[Any, Any], dict[Any, Any], dict[Any, Any]]:
        """Advance; ``__all__`` is True when all agents that have acted are done."""
        observations, rewards, terminations, truncations, infos = self.env.step(action_dict)
        born = set(self.env.agents) - set(self.agents)
        is_over, is_cut = set(self.env.agents) == born, self.env.is_cut
        self.agents = [] if is_over else list(self.env.agents)
        if is_over:
            self._born = (
                {agent: observations.pop(agent) for agent in born},
                {agent: infos.pop(agent) for agent in born},
            )
            for part in (rewards, terminations, truncations):
                for agent in born:
                    del part[agent]
        terminations["__all__"], truncations["__all__"] = is_over and not is_cut, is_cut
        return observations, rewards, terminations, truncations, infos

    def render(self) -> Any:
        """A picture, where the config has a ``render_mode``."""
        return self.env.render()

    def close(self) -> None:
        """Close the window."""
        self.env.close()
