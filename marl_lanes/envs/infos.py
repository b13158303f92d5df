"""What an agent's info says, and what a step of the PettingZoo environment returns."""

import numpy as np
from numpy.typing import NDArray

from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.traffic.roles.follower import FOLLOWER

Step = tuple[
    dict[str, NDArray[np.float32]],
    dict[str, float],
    dict[str, bool],
    dict[str, bool],
    dict[str, dict[str, float]],
]
"""Observations, rewards, terminations, truncations and infos, by agent."""

FIELDS = ("phase", "outcome", "num_aborts")
"""Of the table AGENT, which an info has."""

_NAMES = {
    CHANGER.name: (*FIELDS, *CHANGER.reward_names),
    FOLLOWER.name: ("phase", "is_paired", *FOLLOWER.reward_names),
}


def info_names(agent: str) -> tuple[str, ...]:
    """Keys of the agent's info."""
    return _NAMES[agent.rpartition("_")[0]]
