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
    """Rows of the CPU's memory, or of the device's, on the device.

    To a GPU they go by way of pinned memory, and the call does not wait for their arrival.
    """
    is_there = rows.device is not None and rows.device.type != "cpu"
    if device.type == "cpu" or is_there:
        return rows
    return rows.pin_memory().to(device, non_blocking=True)


def live_transitions(
    batch: TensorDictBase,
    group: str = CHANGER.group,
    *,
    num_steps: int = 1,
    gamma: float = 1.0,
) -> TensorDict:
    """The transitions of the agents that acted, one row each, for a replay buffer.

    Rows are those in which the agent was ``acting``: its action had an effect. ``terminated`` and
    ``truncated`` are the agent's own, and an attempt that is over terminates, too: a changer's that
    is back in its lane and waits without acting, a follower's that has lost its changer. What comes
    after it is another attempt, in a world that the observation does not tell from the present one:
    a value that looked into it would be a mixture of both.

    With ``num_steps`` n a row looks ahead over n steps, or fewer where its attempt or the batch
    ends: its reward is sum_k gamma^k r_k, and "next" is that of the last of them.

    Args:
        batch: (E, T) from a collector over ``LaneChangeEnv``; with one step of any shape before the
            slots.
        group: the group's name.
        num_steps: n, 1 or more.
        gamma: discount factor of the rewards.

    Returns:
        (N,) with observation, action, of changers is_aborting (N,), and next: observation, reward,
        done, terminated, truncated. With more than one step also steps_to_next_obs (N, 1) int64,
        where TorchRL's value estimators look for the exponent of gamma.
    """
    now, after = batch[group], batch["next", group]
    following = {
        key: after[key] for key in ("observation", "reward", "done", "terminated", "truncated")
    }
    is_over = ~after["acting"].unsqueeze(-1)
    if group == CHANGER.group:
        # Missed, timed out, and the horizon: the road or the time ends, and not the attempt.
        is_over &= ~following["truncated"]
    following["done"] = following["done"] | is_over
    following["terminated"] = following["terminated"] | is_over
    columns = {"observation": now["observation"], "action": now["action"]}
    if group == CHANGER.group:
        columns["is_aborting"] = now["aborting"]
    if num_steps > 1:
        following, columns["steps_to_next_obs"] = _look_ahead(
            following, batch.ndim - 1, num_steps, gamma
        )
    # Found once, not for every column: to know how many they are is to wait for a GPU.
    acting = now["acting"].nonzero(as_tuple=True)
    rows = {key: column[acting] for key, column in columns.items()}
    size = [rows["action"].shape[0]]
    ends = TensorDict({key: column[acting] for key, column in following.items()}, size)
    return TensorDict({**rows, "next": ends}, size, device=batch.device)


def _look_ahead(
    following: dict[str, Tensor], time: int, num_steps: int, gamma: float
) -> tuple[dict[str, Tensor], Tensor]:
    """What follows after several steps, and after how many, (..., T, A, 1).

    TorchRL's MultiStep leaves done and terminated where they are, so a target would bootstrap from
    the end of an episode.
    """
    done, reward = following["done"], following["reward"]
    length = done.shape[time]
    shape = [1] * done.ndim
    shape[time] = length
    start = torch.arange(length, device=done.device).view(shape).expand_as(done)
    last, total, goes_on = start, reward, ~done
    for step in range(1, min(num_steps, length)):
        later = (start + step).clamp(max=length - 1)
        goes_on = goes_on & (start + step < length)
        total = total + gamma**step * torch.where(goes_on, reward.gather(time, later), 0.0)
        last = torch.where(goes_on, later, last)
        goes_on = goes_on & ~done.gather(time, later)
    found = {
        key: column.gather(time, last.expand_as(column))
        for key, column in following.items()
        if key != "reward"
    }
    return {**found, "reward": total}, last - start + 1


def finished_maneuvers(batch: TensorDictBase, group: str = CHANGER.group) -> tuple[Tensor, Tensor]:
    """The agent's return and the outcome of every command that ended in the batch, (N,) each."""
    after = batch["next", group]
    ended = after["done"].squeeze(-1).nonzero(as_tuple=True)
    outcome = batch["next", CHANGER.group, "outcome"]
    return after["command_reward"].squeeze(-1)[ended], outcome[ended]


class LivePolicy(TensorDictModuleBase):
    """Evaluate a policy for the agents that act; the other slots get zeros.

    On the CPU no other slot is evaluated. On a GPU all are: to pick some is to wait until their
    number is known.

    Args:
        policy: observations (N, F) to actions (N, D).
        action_dim: D.
        group: the group's name.
        device: of the policy; what it reads and writes is there or on the CPU.
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
        evaluate = self._act_at_live if observation.device.type == "cpu" else self._act_at_all
        with torch.no_grad():
            tensordict.set((self.group, "action"), evaluate(observation, acting))
        return tensordict

    def _act_at_live(self, observation: Tensor, acting: Tensor) -> Tensor:
        action = observation.new_zeros((*acting.shape, self.action_dim))
        action[acting] = self.policy(send(observation[acting], self.device)).to(action.device)
        return action

    def _act_at_all(self, observation: Tensor, acting: Tensor) -> Tensor:
        action: Tensor = self.policy(observation.flatten(end_dim=-2))
        return torch.where(acting.unsqueeze(-1), action.view(*acting.shape, -1), 0.0)
