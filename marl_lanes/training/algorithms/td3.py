"""TD3 as an algorithm of the learner, and its configuration."""

from collections.abc import Mapping
from typing import Any

import torch
from pydantic import Field
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.objectives import TD3Loss

from marl_lanes.envs.batched import LaneChangeEnv
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.training.algorithms.actor_critic import ActorNetwork
from marl_lanes.training.algorithms.exploration import NoisyActor
from marl_lanes.training.algorithms.off_policy import (
    ActorCritic,
    ActorCriticConfig,
    CriticLossConfig,
    make_critics,
    parameters_of,
)
from marl_lanes.training.config import ExplorationConfig, Number, Sigma
from marl_lanes.training.transitions import CPU

NUM_CRITICS = 2
"""The target is the lower one of their values."""


class TD3LossConfig(CriticLossConfig):
    """TD3Loss and its targets."""

    target_noise: Sigma = Field(
        description="standard deviation of the noise on the target actor's action, of each half "
        "range [1]"
    )
    target_noise_bound: Sigma = Field(description="to which it is clipped, of each half range [1]")
    actor_interval: Number = Field(
        description="updates of the critics for one of the actor and of the targets"
    )


class TD3Config(ActorCriticConfig):
    """How one group learns with TD3."""

    loss: TD3LossConfig
    exploration: ExplorationConfig


class TD3(ActorCritic):
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

    config: TD3Config
    loss: TD3Loss
    actor: NoisyActor
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
        network = network.to(device)
        box = network.box
        # TorchRL multiplies and clips with them; as tensors they have a value for each action.
        noise: Any = config.loss.target_noise * box.half_range
        bound: Any = config.loss.target_noise_bound * box.half_range
        loss = TD3Loss(
            network.policy(),
            make_critics(network, config.network.hidden_sizes, NUM_CRITICS, device),
            bounds=(box.low, box.high),
            num_qvalue_nets=NUM_CRITICS,
            policy_noise=noise,
            noise_clip=bound,
            loss_function=config.loss.distance,
        )
        loss.make_value_estimator(gamma=config.loss.gamma, device=device)
        actor = NoisyActor(config.exploration, env, network, group, device, acting_device)
        parts = [
            parameters_of(one) for one in (loss.qvalue_network_params, loss.actor_network_params)
        ]
        super().__init__(config, network, loss, actor, parts, group=group, device=device)

    def anneal(self, transitions: int) -> None:
        """Set noise and step sizes, given the number of transitions so far."""
        super().anneal(transitions)
        self.actor.anneal(transitions)

    def schedules(self) -> Mapping[str, float]:
        """The noise as a share of each half range."""
        return {"sigma": self.actor.sigma}

    def take_step(self, batch: TensorDictBase, number: int) -> Mapping[str, Tensor]:
        """Make one update of the critics, and of the actor and the targets if it is due."""
        loss, _ = self.loss.value_loss(batch)
        self.descend(loss, self.critic_parameters)
        if number % self.config.loss.actor_interval:
            return {"loss": loss.detach()}
        actor_loss, _ = self.loss.actor_loss(batch)
        self.descend(actor_loss, self.actor_parameters)
        self.target_updater.step()
        return {"loss": loss.detach(), "actor_loss": actor_loss.detach()}
