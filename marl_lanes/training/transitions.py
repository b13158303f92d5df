"""From a collected batch of slots to the transitions and maneuvers of acting agents."""

from typing import TypeVar

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn

from marl_lanes.traffic.roles.changer import CHANGER

CPU = torch.device("cpu")

Rows = TypeVar("Rows", Tensor, TensorDict)


def send(rows: Rows, device: torch.device) -> Rows:
    """What lies in the CPU's memory, on the device.

    To a GPU it goes by way of pinned memory, and the call does not wait for its arrival.
    """
    if device.type == "cpu":
        return rows
    return rows.pin_memory().to(device, non_blocking=True)


def live_transitions(batch: TensorDictBase, group: str = CHANGER.group) -> TensorDict:
    """The transitions of the agents that acted, one row each, for a replay buffer.

    Rows are those in which the agent was ``acting``: its action had an effect. ``terminated`` and
    ``truncated`` are the agent's own, and an attempt that is over terminates, too: a changer's that
    is back in its lane and waits without acting, a follower's that has lost its changer. What comes
    after it is another attempt, in a world that the observation does not tell from the present one:
    a value that looked into it would be a mixture of both.

    Args:
        batch: (E, T) from a collector over ``LaneChangeEnv``, or of any shape before the slots.
        group: the group's name.

    Returns:
        (N,) with observation, action, of changers is_aborting (N,), and next: observation, reward,
        done, terminated, truncated.
    """
    now, after = batch[group], batch["next", group]
    acting = now["acting"]
    rows = {
        "observation": now["observation"][acting],
        "action": now["action"][acting],
    }
    following = {
        key: after[key][acting]
        for key in ("observation", "reward", "done", "terminated", "truncated")
    }
    is_over = ~after["acting"][acting].unsqueeze(-1)
    if group == CHANGER.group:
        rows["is_aborting"] = now["aborting"][acting]
        # Missed, and the horizon: the road ends, and not the attempt.
        is_over &= ~following["truncated"]
    following["done"] = following["done"] | is_over
    following["terminated"] = following["terminated"] | is_over
    size = [rows["action"].shape[0]]
    return TensorDict({**rows, "next": TensorDict(following, size)}, size, device=batch.device)


def finished_maneuvers(batch: TensorDictBase, group: str = CHANGER.group) -> tuple[Tensor, Tensor]:
    """The agent's return and the outcome of every command that ended in the batch, (N,) each."""
    after = batch["next", group]
    ended = after["done"].squeeze(-1)
    outcome = batch["next", CHANGER.group, "outcome"]
    return after["episode_reward"].squeeze(-1)[ended], outcome[ended]


class LivePolicy(TensorDictModuleBase):
    """Evaluate a policy for the agents that act, and no other slot; the others get zeros.

    Args:
        policy: observations (N, F) to actions (N, D).
        action_dim: D.
        group: the group's name.
        device: of the policy; what it reads and writes is on the CPU.
    """

    def __init__(
        self,
        policy: nn.Module,
        action_dim: int,
        group: str = CHANGER.group,
        *,
        device: torch.device = CPU,
    ) -> None:
        super().__init__()
        self.policy = policy
        self.device = device
        self.action_dim = action_dim
        self.group = group
        self.in_keys = [(group, "observation"), (group, "acting")]
        self.out_keys = [(group, "action")]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the action, (..., A, D), zero where no agent acts."""
        observation = tensordict[self.group, "observation"]
        acting = tensordict[self.group, "acting"]
        action = observation.new_zeros((*acting.shape, self.action_dim))
        with torch.no_grad():
            action[acting] = self.policy(send(observation[acting], self.device)).to(action.device)
        tensordict.set((self.group, "action"), action)
        return tensordict
