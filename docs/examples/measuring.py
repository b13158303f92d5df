"""What the examples have in common: the traffic that they train in, and how they measure a policy.

Of a command: the mean sum of its rewards, and the share of commands that were completed. A policy
that never steers pays little and completes nothing, so neither is told alone.
"""

from pathlib import Path

import numpy as np

from marl_lanes import parallel_env
from marl_lanes.files import write_text

SCENARIO = "paper"
TRAFFIC = {
    "num_agents": 4,
    "command": {"probability": 1.0},
    "departures": {"interval": [3.0, 5.0]},
    "horizon": 120.0,
}
"""Every vehicle is commanded, and soon: of a constant population a third is live, not a tenth."""

COMPLETED = 1.0
NUM_POINTS = 8
"""Of a curve, after the first."""


def add_options(parser):
    """Add --episodes and --curve."""
    parser.add_argument("--episodes", type=int, default=10, help="of each measurement")
    parser.add_argument(
        "--curve",
        type=Path,
        metavar="FILE.csv",
        help="measure on the way, too, and write the points to this file",
    )


class Curve:
    """Measurements of a policy before, during and after its training.

    Args:
        act: normalised observations (N, F) to normalised actions (N, D).
        options: those of ``add_options``.
        name: begins the lines of text.
    """

    def __init__(self, act, options, name=""):
        self._act, self._options, self._name = act, options, name
        self._num_points = 0
        self._rows = ["num_steps,return,completed"]
        self._measure(0, "before")

    def reach(self, num_steps, share):
        """Measure where the training has come to the next point, if a curve is wanted.

        Args:
            num_steps: of a road, until now.
            share: of the training that is done.
        """
        num_points = int(share * NUM_POINTS)
        if self._options.curve and self._num_points < num_points < NUM_POINTS:
            self._measure(num_steps, f"{num_steps:,} steps")
        self._num_points = num_points

    def end(self, num_steps):
        """Measure after the training, and write the curve if one is wanted."""
        self._measure(num_steps, "after")
        if self._options.curve:
            write_text(self._options.curve, "\n".join(self._rows) + "\n")

    def _measure(self, num_steps, when):
        mean, share, num_commands = measure(self._act, self._options.episodes)
        told = f"return {mean:.2f}, completed {share:.2f} of {num_commands} commands"
        print(f"{self._name}{when}: {told}", flush=True)
        self._rows.append(f"{num_steps},{mean:.6f},{share:.6f}")


def measure(act, num_episodes):
    """The mean return of a command on roads that no training has seen, and the completed share.

    Args:
        act: as above.
        num_episodes: of four commands.

    Returns:
        Both, and the number of commands.
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
    return np.mean(returns), np.mean(successes), len(successes)
