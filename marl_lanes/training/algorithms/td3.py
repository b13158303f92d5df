"""TD3 as an algorithm of the learner, and its configuration."""

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import torch
from pydantic import Field
from tensordict import TensorDictBase
from torch import Tensor, nn
from torch.nn.utils import clip_grad_norm_
from torchrl.modules import ValueOperator
from torchrl.objectives import SoftUpdate, TD3Loss

from marl_lanes.envs.batched import LaneChangeEnv
from marl_lanes.scenario.fields import Real, Section
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.training.algorithms.actor_critic import ActorNetwork, CriticNetwork
from marl_lanes.training.algorithms.algorithm import Algorithm
from marl_lanes.training.algorithms.exploration import NoisyActor
from marl_lanes.training.config import (
    LearnerConfig,
    Magnitude,
    Number,
    OptimizerConfig,
    Sigma,
    Widths,
)
from marl_lanes.training.transitions import CPU

NUM_CRITICS = 2
"""The target is the lower one of their values."""


class TD3LossConfig(Section):
    """TD3Loss and its targets."""

    gamma: Real = Field(ge=0.0, le=1.0, description="discount factor")
    tau: Real = Field(gt=0.0, le=1.0, description="step of the targets' soft update")
    distance: Literal["l1", "l2", "smooth_l1"] = Field(
        description="of the critics from their target: l1, l2 or smooth_l1"
    )
    target_noise: Sigma = Field(
        description="standard deviation of the noise on the target actor's action, of each half "
        "range [1]"
    )
    target_noise_bound: Sigma = Field(description="to which it is clipped, of each half range [1]")
    actor_interval: Number = Field(
        description="updates of the critics for one of the actor and of the targets"
    )


class TD3OptimizerConfig(OptimizerConfig):
    """Adam for the critics, and for the actor."""

    actor_learning_rate: Magnitude = Field(description="step size of the actor")


class TD3NetworkConfig(Section):
    """Form of actor and critics."""

    hidden_sizes: Widths = Field(description="widths of the hidden layers of every network")


class TD3Config(LearnerConfig):
    """How one group learns with TD3."""

    loss: TD3LossConfig
    optimizer: TD3OptimizerConfig
    network: TD3NetworkConfig


class TD3(Algorithm):
    """Twin delayed deep deterministic policy gradient.

    The target of the critics is r + gamma (1 - terminated) min_i Q_i(s', a'; target), where a' is
    the target actor's action with clipped noise, clipped to the bounds. The actor maximizes the
    first critic.

    Args:
        config: its settings.
        env: the environment that collects, or the pattern of the workers' environments.
        network: the actor; it is moved to the device and changed in place.
        group: name of the group of agents.
        device: where the networks learn.
        acting_device: where the actor acts; in workers on the CPU.

    Source: Fujimoto et al. 2018, "Addressing Function Approximation Error in Actor-Critic Methods".
    """

    columns = ("loss", "actor_loss", "sigma")

    def __init__(
        self,
        config: TD3Config,
        env: LaneChangeEnv,
        network: ActorNetwork,
        *,
        group: str = CHANGER.group,
        device: torch.device = CPU,
        acting_device: torch.device = CPU,
    ) -> None:
        self.config = config
        self.network: ActorNetwork = network.to(device)
        self.group = group
        self.device = device
        critics = [
            ValueOperator(
                CriticNetwork(network, config.network.hidden_sizes),
                in_keys=["observation", "action"],
                out_keys=["state_action_value"],
            ).to(device)
            for _ in range(NUM_CRITICS)
        ]
        box = network.box
        # TorchRL multiplies and clips with them; as tensors they have a value for each action.
        noise: Any = config.loss.target_noise * box.half_range
        bound: Any = config.loss.target_noise_bound * box.half_range
        self.loss = TD3Loss(
            network.policy(),
            critics,
            bounds=(box.low, box.high),
            num_qvalue_nets=NUM_CRITICS,
            policy_noise=noise,
            noise_clip=bound,
            loss_function=config.loss.distance,
        )
        self.loss.make_value_estimator(gamma=config.loss.gamma, device=device)
        # Its gamma has torch's default dtype, which may be another than that of the networks.
        self.loss.value_estimator.to(box.low.dtype)
        self.target_updater = SoftUpdate(self.loss, tau=config.loss.tau)
        self.critic_parameters = _parameters(self.loss.qvalue_network_params)
        self.actor_parameters = _parameters(self.loss.actor_network_params)
        optimizer = config.optimizer
        self.rates = optimizer.learning_rate, optimizer.actor_learning_rate
        groups = zip((self.critic_parameters, self.actor_parameters), self.rates, strict=True)
        self.optimizer = torch.optim.Adam(
            [{"params": parameters, "lr": rate} for parameters, rate in groups], fused=True
        )
        self.actor = NoisyActor(config.exploration, env, network, group, device, acting_device)
        self.policy = self.actor.policy

    def refresh_policy(self) -> None:
        """Copy the learned weights to the policy, if it has its own."""
        self.actor.refresh()

    def anneal(self, transitions: int) -> None:
        """Set noise and step sizes, given the number of transitions so far."""
        self.actor.anneal(transitions)
        share = min(1.0, transitions / self.config.collector.total_transitions)
        for group, rate in zip(self.optimizer.param_groups, self.rates, strict=True):
            group["lr"] = rate * (1.0 - share * (1.0 - self.config.optimizer.final_rate))

    def schedules(self) -> Mapping[str, float]:
        """The noise as a share of each half range."""
        return {"sigma": self.actor.sigma}

    def take_step(self, batch: TensorDictBase, number: int) -> Mapping[str, Tensor]:
        """Make one update of the critics, and of the actor and the targets if it is due."""
        loss, _ = self.loss.value_loss(batch)
        self._descend(loss, self.critic_parameters)
        if number % self.config.loss.actor_interval:
            return {"loss": loss.detach()}
        actor_loss, _ = self.loss.actor_loss(batch)
        self._descend(actor_loss, self.actor_parameters)
        self.target_updater.step()
        return {"loss": loss.detach(), "actor_loss": actor_loss.detach()}

    def _descend(self, loss: Tensor, parameters: Sequence[nn.Parameter]) -> None:
        """Update these parameters alone: Adam skips parameters without a gradient."""
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        if self.config.optimizer.max_gradient_norm is not None:
            clip_grad_norm_(parameters, self.config.optimizer.max_gradient_norm, foreach=True)
        self.optimizer.step()


def _parameters(params: Any) -> list[nn.Parameter]:
    """The parameters of a loss's network, without its buffers."""
    return [one for one in params.values(True, True) if isinstance(one, nn.Parameter)]
