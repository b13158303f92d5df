"""DDPG as an algorithm of the learner, and its configuration."""

from collections.abc import Mapping

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.objectives import DDPGLoss

from marl_lanes.envs.batched import LaneChangeEnv
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.training.algorithms.actor_critic import ActorNetwork
from marl_lanes.training.algorithms.exploration import NoisyActor
from marl_lanes.training.algorithms.off_policy import (
    ActorCritic,
    ActorCriticConfig,
    make_critics,
    parameters_of,
)
from marl_lanes.training.config import ExplorationConfig
from marl_lanes.training.transitions import CPU


class DDPGConfig(ActorCriticConfig):
    """How one group learns with DDPG."""

    exploration: ExplorationConfig


class DDPG(ActorCritic):
    """Deep deterministic policy gradient.

    The target of the critic is r + gamma (1 - terminated) Q(s', a'; target), where a' is the target
    actor's action. The actor maximizes the critic.

    Args:
        config: its settings.
        env: the environment that collects, or the pattern of the workers' environments.
        network: the actor; it is moved to the device and changed in place.
        group: name of the group of agents.
        device: where the networks learn.
        acting_device: where the actor acts; in workers on the CPU.

    Source: Lillicrap et al. 2016, "Continuous Control with Deep Reinforcement Learning".
    """

    config: DDPGConfig
    loss: DDPGLoss
    actor: NoisyActor
    columns = ("loss", "actor_loss", "sigma")

    def __init__(
        self,
        config: DDPGConfig,
        env: LaneChangeEnv,
        network: ActorNetwork,
        *,
        group: str = CHANGER.group,
        device: torch.device = CPU,
        acting_device: torch.device = CPU,
    ) -> None:
        network = network.to(device)
        (critic,) = make_critics(network, config.network.hidden_sizes, 1, device)
        loss = DDPGLoss(
            network.policy(), critic, loss_function=config.loss.distance, delay_actor=True
        )
        loss.make_value_estimator(gamma=config.loss.gamma, device=device)
        actor = NoisyActor(config.exploration, env, network, group, device, acting_device)
        parts = [
            parameters_of(one) for one in (loss.value_network_params, loss.actor_network_params)
        ]
        super().__init__(config, network, loss, actor, parts, group=group, device=device)

    def anneal(self, transitions: int) -> None:
        """Set noise and step sizes, given the number of transitions so far."""
        super().anneal(transitions)
        self.actor.anneal(transitions)

    def schedules(self) -> Mapping[str, float]:
        """The noise as a share of each half range."""
        return {"sigma": self.actor.sigma}

    def take_step(self, batch: TensorDictBase, number: int) -> Mapping[str, Tensor]:  # noqa: ARG002
        """Make one update of the critic, of the actor and of the targets."""
        loss, _ = self.loss.loss_value(batch)
        self.descend(loss, self.critic_parameters)
        actor_loss, _ = self.loss.loss_actor(batch)
        self.descend(actor_loss, self.actor_parameters)
        self.target_updater.step()
        return {"loss": loss.detach(), "actor_loss": actor_loss.detach()}
