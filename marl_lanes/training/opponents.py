"""Opponents of a learner: how often each is met, and many of them on the roads at once."""

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import nn

from marl_lanes.traffic.roles.changer import CHANGER


def prioritise(win_rates: ArrayLike, exponent: float) -> NDArray[np.float64]:
    """How often a learner meets each opponent: p_k = (1 - x_k)^c / sum over j of (1 - x_j)^c.

    x_k is how often the learner wins against opponent k. The larger c, the more it meets those that
    it loses to; c = 0 is fictitious self-play, all alike. If it always wins, all are alike, too.

    Source: prioritised fictitious self-play, f_hard in Vinyals et al. 2019, Grandmaster level in
    StarCraft II using multi-agent reinforcement learning, Nature 575, Methods; c was 2 there for
    the main agents.

    Args:
        win_rates: (K,) between 0 and 1.
        exponent: c, at least 0.

    Returns:
        shares, (K,); their sum is 1.
    """
    weights = (1.0 - np.asarray(win_rates, np.float64)) ** exponent
    total = weights.sum()
    return np.asarray(weights / total if total > 0.0 else np.full(weights.size, 1 / weights.size))


def allot(shares: ArrayLike, number: int) -> NDArray[np.int64]:
    """Divide ``number`` things by the shares: at most 1 away from exact, (K,).

    Args:
        shares: (K,); their sum is 1.
        number: of things.
    """
    ends = np.rint(np.cumsum(np.asarray(shares, np.float64)) * number).astype(np.int64)
    return np.diff(ends, prepend=0)


class PoolPolicy(TensorDictModuleBase):
    """Changers of several policies, each on roads of its own.

    Args:
        policies: observations (N, F) to actions (N, D).
        num_roads: (K,) roads of each; their sum is the number of roads.
        action_dim: D.
    """

    def __init__(
        self, policies: Sequence[nn.Module], num_roads: Sequence[int], action_dim: int
    ) -> None:
        super().__init__()
        self.policies = nn.ModuleList(policies)
        self.register_buffer(
            "driver", torch.repeat_interleave(torch.tensor(num_roads)), persistent=False
        )
        self.action_dim = action_dim
        self.in_keys = [(CHANGER.group, "observation"), (CHANGER.group, "acting")]
        self.out_keys = [(CHANGER.group, "action")]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the action, (E, A, D), zero where no agent acts."""
        observation = tensordict[CHANGER.group, "observation"]
        acting = tensordict[CHANGER.group, "acting"]
        action = observation.new_zeros((*acting.shape, self.action_dim))
        with torch.no_grad():
            for index, policy in enumerate(self.policies):
                own = acting & (self.driver == index).unsqueeze(-1)
                action[own] = policy(observation[own])
        tensordict.set((CHANGER.group, "action"), action)
        return tensordict
