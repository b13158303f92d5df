"""What an algorithm is to the learner that trains with it."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import ClassVar

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.objectives.common import LossModule

from marl_lanes.naf.checkpoint import PolicyNetwork


class Algorithm(ABC):
    """A loss, its optimiser and schedules, and the policy that collects.

    It is off-policy: the learner draws batches of transitions from its replay buffer. Collecting,
    replay, run folder, resuming and evaluating are the learner's.

    Attributes:
        columns: of the table of metrics, what it tells: names of losses, among them ``loss``, and
            of schedules.
        pretraining_transitions: after which another stage begins; 0 where there is one stage.
        network: that a checkpoint holds, with its greedy policy; where it learns.
        loss: whose state, with all parameters and targets, is part of the training state.
        optimizer: whose state is, too.
        policy: drives the group while transitions are collected, exploration included.
        group: that it drives.
        device: where it learns.
    """

    columns: ClassVar[tuple[str, ...]]
    pretraining_transitions: int = 0
    network: PolicyNetwork
    loss: LossModule
    optimizer: torch.optim.Optimizer
    policy: TensorDictModuleBase
    group: str
    device: torch.device

    @abstractmethod
    def refresh_policy(self) -> None:
        """Let the policy be what has been learned."""

    @abstractmethod
    def anneal(self, transitions: int) -> None:
        """Set exploration, step sizes and stage for those that come after so many transitions."""

    @abstractmethod
    def schedules(self) -> Mapping[str, float]:
        """Where they stand, by column."""

    @abstractmethod
    def take_step(self, batch: TensorDictBase, number: int) -> Mapping[str, Tensor]:
        """One update of the networks, and what is due of the targets.

        Args:
            batch: transitions as ``live_transitions`` makes them, (batch_size,), on the device.
            number: of the update, from 1.

        Returns:
            losses by column, scalars on the device, without gradient: the call does not wait for a
            GPU. What is not updated each time may be absent.
        """
