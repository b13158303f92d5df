"""What the examples have in common: the traffic that they train in, and how they measure a policy.

Of a command: the mean sum of its rewards, and the share of commands that were completed. A policy
that never steers pays little and completes nothing, so neither is told alone.
"""

import numpy as np

from marl_lanes import parallel_env

SCENARIO = "paper"
TRAFFIC = {
    "num_agents": 4,
    "command": {"probability": 1.0},
    "departures": {"interval": [3.0, 5.0]},
    "horizon": 120.0,
}
"""Every vehicle is commanded, and soon: of a constant population a third is live, not a tenth."""

COMPLETED = 1.0


def measure(act, num_episodes=10):
    """The returns and the successes of a policy on roads that no training has seen.

    Args:
        act: normalised observations (N, F) to normalised actions (N, D).
        num_episodes: of four commands.

    Returns:
        A line of text.
    """
    env = parallel_env(SCENARIO, normalised=True, overrides=TRAFFIC, seed=10_000)
    returns, successes = [], []
    for _ in range(num_episodes):
        observations, _ = env.reset()
        paid = {}
        while env.agents:
            rows = np.stack([observations[agent] for agent in env.agents])
            actions = dict(zip(env.agents, np.asarray(act(rows)), strict=True))
            observations, rewards, _, _, infos = env.step(actions)
            for agent, reward in rewards.items():
                paid[agent] = paid.get(agent, 0.0) + reward
            successes += [i["outcome"] == COMPLETED for i in infos.values() if i["outcome"]]
        returns += paid.values()
    share = np.mean(successes)
    return f"return {np.mean(returns):.2f}, completed {share:.2f} of {len(successes)} commands"
