"""What algorithms with an actor, critics and a replay buffer share."""

from collections.abc import Sequence
from typing import Any, Literal, Protocol

import torch
from pydantic import Field
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torch.nn.utils import clip_grad_norm_
from torchrl.modules import ValueOperator
from torchrl.objectives import SoftUpdate
from torchrl.objectives.common import LossModule

from marl_lanes.scenario.fields import Real, Section
from marl_lanes.training.algorithms.actor_critic import ActorNetwork, CriticNetwork
from marl_lanes.training.algorithms.algorithm import OffPolicy
from marl_lanes.training.config import (
    Magnitude,
    Number,
    OffPolicyConfig,
    OffPolicyOptimizerConfig,
    OptimizerConfig,
    Widths,
)
from marl_lanes.training.transitions import live_transitions


class Actor(Protocol):
    """Acts while transitions are collected."""

    policy: TensorDictModuleBase

    def refresh(self) -> None:
        """Copy the learned weights, if it acts with a copy."""


class CriticLossConfig(Section):
    """What the losses of actors and critics have in common, and the targets."""

    gamma: Real = Field(ge=0.0, le=1.0, description="discount factor")
    num_steps: Number = Field(
        le=1000,
        description="steps of reward before the targets' value: more bring the value of an end "
        "sooner to the states before it; at most to the end of a collected batch",
    )
    tau: Real = Field(gt=0.0, le=1.0, description="step of the targets' soft update")
    distance: Literal["l1", "l2", "smooth_l1"] = Field(
        description="of the critics from their target: l1, l2 or smooth_l1"
    )


class ActorOptimizerConfig(OptimizerConfig):
    """Adam for the critics, and for the actor."""

    actor_learning_rate: Magnitude = Field(description="step size of the actor")


class ActorCriticOptimizerConfig(ActorOptimizerConfig, OffPolicyOptimizerConfig):
    """The same, for updates from a replay buffer."""


class ActorNetworkConfig(Section):
    """Form of actor and critics."""

    hidden_sizes: Widths = Field(description="widths of the hidden layers of every network")


class ActorCriticConfig(OffPolicyConfig):
    """How one group learns with an actor and critics."""

    loss: CriticLossConfig
    optimizer: ActorCriticOptimizerConfig
    network: ActorNetworkConfig


class ActorCritic(OffPolicy):
    """An actor and critics with target networks.

    Args:
        config: its settings.
        network: the actor, which checkpoints hold.
        loss: TorchRL's, with its value estimator.
        actor: acts while transitions are collected.
        parts: parameters of the critics, and of the actor.
        group: name of the group of agents.
        device: where the networks learn.
    """

    config: ActorCriticConfig

    def __init__(
        self,
        config: ActorCriticConfig,
        network: ActorNetwork,
        loss: LossModule,
        actor: Actor,
        parts: Sequence[Sequence[nn.Parameter]],
        *,
        group: str,
        device: torch.device,
    ) -> None:
        self.config = config
        self.network: ActorNetwork = network
        self.group = group
        self.device = device
        self.loss = loss
        # Its gamma has torch's default dtype, which may be another than that of the networks.
        self.loss.value_estimator.to(network.box.low.dtype)
        self.target_updater = SoftUpdate(self.loss, tau=config.loss.tau)
        self.critic_parameters, self.actor_parameters = parts
        self.optimizer, self.rates = make_optimizer(config.optimizer, *parts)
        self.actor = actor
        self.policy = actor.policy

    def take_in(self, batch: TensorDictBase) -> TensorDict:
        """The transitions of a collected batch, (N,), over ``loss.num_steps`` steps each."""
        loss = self.config.loss
        return live_transitions(batch, self.group, num_steps=loss.num_steps, gamma=loss.gamma)

    def refresh_policy(self) -> None:
        """Copy the learned weights to the policy, if it has its own."""
        self.actor.refresh()

    def anneal(self, transitions: int) -> None:
        """Set the step sizes, given the number of transitions so far."""
        share = min(1.0, transitions / self.config.collector.total_transitions)
        set_rates(self.optimizer, self.rates, self.config.optimizer, share)

    def descend(self, loss: Tensor, parameters: Sequence[nn.Parameter]) -> None:
        """Update these parameters alone: Adam skips parameters without a gradient."""
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        if self.config.optimizer.max_gradient_norm is not None:
            clip_grad_norm_(parameters, self.config.optimizer.max_gradient_norm, foreach=True)
        self.optimizer.step()


def make_optimizer(
    config: ActorOptimizerConfig, critics: Sequence[nn.Parameter], actor: Sequence[nn.Parameter]
) -> tuple[torch.optim.Optimizer, tuple[float, ...]]:
    """Adam with a step size for the critics and one for the actor, and these."""
    rates = config.learning_rate, config.actor_learning_rate
    groups = zip((critics, actor), rates, strict=True)
    settings = [{"params": parameters, "lr": rate} for parameters, rate in groups]
    return torch.optim.Adam(settings, fused=True), rates


def set_rates(
    optimizer: torch.optim.Optimizer, rates: Sequence[float], config: OptimizerConfig, share: float
) -> None:
    """Let the step sizes fall linearly to their final share.

    Args:
        optimizer: whose step sizes are set.
        rates: of its groups of parameters at the start.
        config: says what share is left at the end.
        share: of the training that is over [1].
    """
    for group, rate in zip(optimizer.param_groups, rates, strict=True):
        group["lr"] = rate * (1.0 - share * (1.0 - config.final_rate))


def make_critics(
    network: ActorNetwork, hidden_sizes: Sequence[int], number: int, device: torch.device
) -> list[ValueOperator]:
    """Untrained critics for the actor's features and actions."""
    return [
        ValueOperator(
            CriticNetwork(network, hidden_sizes),
            in_keys=["observation", "action"],
            out_keys=["state_action_value"],
        ).to(device)
        for _ in range(number)
    ]


def parameters_of(params: Any) -> list[nn.Parameter]:
    """The parameters of a loss's network, without its buffers."""
    return [one for one in params.values(True, True) if isinstance(one, nn.Parameter)]
