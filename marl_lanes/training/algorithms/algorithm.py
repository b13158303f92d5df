"""The interface of an algorithm, which the learner uses."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.objectives.common import LossModule

from marl_lanes.naf.checkpoint import PolicyNetwork
from marl_lanes.training.config import LearnerConfig, OffPolicyConfig
from marl_lanes.training.experience import Experience
from marl_lanes.training.replay import Replay
from marl_lanes.training.transitions import live_transitions


class Algorithm(ABC):
    """A loss with its optimizer and schedules, and the policy that collects.

    The algorithm says what a collected batch becomes (``take_in``) and what its updates are drawn
    from (``make_experience``). The learner collects, stores, draws, saves, resumes and evaluates.

    Attributes:
        config: how the group learns.
        columns: its columns in the table of metrics: the names of its losses, ``loss`` among them,
            and of its schedules.
        pretraining_transitions: transitions of a first stage; 0 if there is only one stage.
        network: the network that checkpoints hold, on the device where it learns.
        loss: TorchRL's loss; its state, with all parameters and targets, is saved for resuming.
        optimizer: its state is saved for resuming, too.
        policy: chooses the group's actions while transitions are collected, with exploration.
        group: name of the group of agents.
        device: where it learns.
        is_graphed: whether its updates are CUDA graphs, and its policy can be a part of one: it
            waits for nothing on the GPU.
    """

    config: LearnerConfig
    columns: ClassVar[tuple[str, ...]]
    pretraining_transitions: int = 0
    network: PolicyNetwork
    loss: LossModule
    optimizer: torch.optim.Optimizer
    policy: TensorDictModuleBase
    group: str
    device: torch.device
    is_graphed: bool = False

    @abstractmethod
    def make_experience(self, folder: Path, bytes_per_transition: float) -> Experience:
        """What the updates are drawn from.

        Args:
            folder: for its files, if it has some.
            bytes_per_transition: size of a row of ``take_in``.
        """

    def take_in(self, batch: TensorDictBase) -> TensorDict:
        """The transitions of a collected batch, (N,), as the updates need them.

        Args:
            batch: (E, T) or (N, E/N, T) of slots, which the policy as it is now has collected.
        """
        return live_transitions(batch, self.group)

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
            batch: transitions from ``take_in``, (batch_size,), on the device.
            number: number of the update, starting with 1.

        Returns:
            losses by column, scalars without gradient on the device, so that the call does not wait
            for a GPU. A network that is not updated every time may leave out its loss.
        """


class OffPolicy(Algorithm):
    """An algorithm that learns from a replay buffer."""

    config: OffPolicyConfig

    def make_experience(self, folder: Path, bytes_per_transition: float) -> Replay:
        """A replay buffer."""
        return Replay(
            self.config.replay,
            folder,
            bytes_per_transition,
            self.device,
            transitions_per_update=self.config.optimizer.transitions_per_update,
        )
