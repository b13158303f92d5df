"""An environment of RLlib's new API stack, in which agents are born and end within an episode."""

from collections.abc import Mapping
from typing import Any

from ray.rllib.env.multi_agent_env import MultiAgentEnv

from marl_lanes.envs.forms import parallel_env


class LaneChangeMultiAgentEnv(MultiAgentEnv):
    """The parallel environment, normalised unless the config says otherwise.

    RLlib's own wrapper for PettingZoo ends an episode when every agent that it has seen is done,
    although one may be born in that step. Here the episode ends when the environment says so.

    Args:
        config: RLlib's ``env_config``: arguments of ``parallel_env``. Give no seed there: every
            worker would have the same traffic; RLlib seeds the workers by ``debugging(seed=...)``.
    """

    def __init__(self, config: Mapping[str, Any] | None = None) -> None:
        super().__init__()
        self.env = parallel_env(**{"normalised": True, **(config or {})})
        self.possible_agents = self.env.possible_agents
        self.agents: list[str] = []
        self.observation_spaces = {a: self.env.observation_space(a) for a in self.possible_agents}
        self.action_spaces = {a: self.env.action_space(a) for a in self.possible_agents}

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start an episode."""
        observations, infos = self.env.reset(seed=seed, options=options or None)
        self.agents = list(self.env.agents)
        return observations, infos

    def step(
        self, action_dict: Mapping[str, Any]
    ) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any], dict[str, Any], dict[str, Any]]:
        """Advance; ``__all__`` is True at the episode's end alone."""
        observations, rewards, terminations, truncations, infos = self.env.step(action_dict)
        self.agents = list(self.env.agents)
        is_over, is_cut = not self.agents, self.env.is_cut
        terminations["__all__"], truncations["__all__"] = is_over and not is_cut, is_cut
        return observations, rewards, terminations, truncations, infos

    def render(self) -> Any:
        """A picture, where the config has a ``render_mode``."""
        return self.env.render()

    def close(self) -> None:
        """Close the window."""
        self.env.close()
