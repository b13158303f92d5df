"""The interface of an algorithm, which the learner uses."""

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
    """A loss with its optimizer and schedules, and the policy that collects.

    The algorithm is off-policy: the learner draws batches of transitions from its replay buffer.
    The learner also collects, stores, saves, resumes and evaluates.

    Attributes:
        columns: its columns in the table of metrics: the names of its losses, ``loss`` among them,
            and of its schedules.
        pretraining_transitions: transitions of a first stage; 0 if there is only one stage.
        network: the network that checkpoints hold, on the device where it learns.
        loss: TorchRL's loss; its state, with all parameters and targets, is saved for resuming.
        optimizer: its state is saved for resuming, too.
        policy: chooses the group's actions while transitions are collected, with exploration.
        group: name of the group of agents.
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
        """Copy the learned weights to the policy, if it has its own."""

    @abstractmethod
    def anneal(self, transitions: int) -> None:
        """Set exploration, step sizes and stage, given the number of transitions so far."""

    @abstractmethod
    def schedules(self) -> Mapping[str, float]:
        """Current values of the schedules, by column."""

    @abstractmethod
    def take_step(self, batch: TensorDictBase, number: int) -> Mapping[str, Tensor]:
        """Make one update of the networks, and of the targets if it is due.

        Args:
            batch: transitions from ``live_transitions``, (batch_size,), on the device.
            number: number of the update, starting with 1.

        Returns:
            losses by column, scalars without gradient on the device, so that the call does not wait
            for a GPU. A network that is not updated every time may leave out its loss.
        """
