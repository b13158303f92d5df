"""From a collected batch of slots to the transitions and maneuvers of live agents."""

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn


def live_transitions(batch: TensorDictBase, group: str = "changers") -> TensorDict:
    """The transitions of the agents that steered, one row each, for a replay buffer.

    Rows are those in which the agent was engaged (or aborting) when it acted; a waiting agent's
    action has no effect. ``terminated`` and ``truncated`` are the agent's own.

    Args:
        batch: (E, T) from a collector over ``LaneChangeEnv``, or of any shape before the slots.
        group: the group's name.

    Returns:
        (N,) with observation, action and next: observation, reward, done, terminated, truncated.
    """
    now, after = batch[group], batch["next", group]
    engaged = now["engaged"]
    rows = {
        "observation": now["observation"][engaged],
        "action": now["action"][engaged],
    }
    following = {
        key: after[key][engaged]
        for key in ("observation", "reward", "done", "terminated", "truncated")
    }
    size = [rows["action"].shape[0]]
    return TensorDict({**rows, "next": TensorDict(following, size)}, size, device=batch.device)


def finished_maneuvers(batch: TensorDictBase, group: str = "changers") -> tuple[Tensor, Tensor]:
    """Return and outcome of every command that ended in the batch, two (N,) tensors."""
    after = batch["next", group]
    ended = after["done"].squeeze(-1)
    return after["episode_reward"].squeeze(-1)[ended], after["outcome"][ended]


class LivePolicy(TensorDictModuleBase):
    """Evaluate a policy for the agents that steer, and no other slot; the others get zeros.

    Args:
        policy: observations (N, F) to actions (N, D).
        action_dim: D.
        group: the group's name.
    """

    def __init__(self, policy: nn.Module, action_dim: int, group: str = "changers") -> None:
        super().__init__()
        self.policy = policy
        self.action_dim = action_dim
        self.group = group
        self.in_keys = [(group, "observation"), (group, "engaged")]
        self.out_keys = [(group, "action")]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the action, (..., A, D), zero where no agent steers."""
        observation = tensordict[self.group, "observation"]
        engaged = tensordict[self.group, "engaged"]
        action = observation.new_zeros((*engaged.shape, self.action_dim))
        with torch.no_grad():
            action[engaged] = self.policy(observation[engaged])
        tensordict.set((self.group, "action"), action)
        return tensordict
