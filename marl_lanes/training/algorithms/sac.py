"""SAC as an algorithm of the learner, and its configuration."""

from collections.abc import Mapping

import torch
from pydantic import Field
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.objectives import SACLoss

from marl_lanes.envs.batched import LaneChangeEnv
from marl_lanes.scenario.fields import Real, Section
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.training.algorithms.actor_critic import ActorNetwork, SquashedGaussian
from marl_lanes.training.algorithms.exploration import SamplingActor
from marl_lanes.training.algorithms.off_policy import (
    ActorCritic,
    ActorCriticConfig,
    CriticLossConfig,
    make_critics,
    parameters_of,
)
from marl_lanes.training.config import Magnitude
from marl_lanes.training.transitions import CPU

NUM_CRITICS = 2
"""The target is the lower one of their values."""


class SACLossConfig(CriticLossConfig):
    """SACLoss and its targets."""

    initial_alpha: Magnitude = Field(
        description="weight of the entropy at the start; then it learns, too"
    )
    target_entropy: Real = Field(
        ge=-100.0,
        le=0.0,
        description="entropy that alpha aims at, of each action as a share of its half range",
    )


class InitialSigmaConfig(Section):
    """Distribution of the actions at the start."""

    initial_sigma: Magnitude = Field(
        description="standard deviation at the start, of each action's half range [1]"
    )


class SACConfig(ActorCriticConfig):
    """How one group learns with SAC."""

    loss: SACLossConfig
    exploration: InitialSigmaConfig


class SAC(ActorCritic):
    """Soft actor-critic with a learned weight alpha of the entropy.

    The target of the critics is r + gamma (1 - terminated) (min_i Q_i(s', a'; target) - alpha log
    pi(a'|s')), a' drawn from pi. The actor maximizes min_i Q_i - alpha log pi, and alpha rises as
    long as the entropy is below its target. The greedy action is the actor's, without its
    distribution.

    Args:
        config: its settings.
        env: the environment that collects, or the pattern of the workers' environments.
        network: the actor; it is moved to the device and changed in place.
        group: name of the group of agents.
        device: where the networks learn.
        acting_device: where the actor acts; in workers on the CPU.

    Source: Haarnoja et al. 2018, "Soft Actor-Critic Algorithms and Applications".
    """

    config: SACConfig
    loss: SACLoss
    columns = ("loss", "actor_loss", "alpha", "entropy")

    def __init__(
        self,
        config: SACConfig,
        env: LaneChangeEnv,  # noqa: ARG002
        network: ActorNetwork,
        *,
        group: str = CHANGER.group,
        device: torch.device = CPU,
        acting_device: torch.device = CPU,
    ) -> None:
        network = network.to(device)
        half_range = network.box.half_range
        widths = config.network.hidden_sizes
        sigma = torch.full_like(half_range, config.exploration.initial_sigma)
        policy = SquashedGaussian(network, widths, sigma).to(device).policy()
        # The loss has the entropy of actions in their units.
        units = float(half_range.log().sum())
        loss = SACLoss(
            policy,
            make_critics(network, widths, NUM_CRITICS, device),
            num_qvalue_nets=NUM_CRITICS,
            loss_function=config.loss.distance,
            alpha_init=config.loss.initial_alpha,
            target_entropy=units + half_range.numel() * config.loss.target_entropy,
        )
        loss.make_value_estimator(gamma=config.loss.gamma, device=device)
        actor = SamplingActor(policy, half_range.numel(), group, device, acting_device)
        critics = [*parameters_of(loss.qvalue_network_params), loss.log_alpha]
        parts = [critics, parameters_of(loss.actor_network_params)]
        super().__init__(config, network, loss, actor, parts, group=group, device=device)

    def schedules(self) -> Mapping[str, float]:
        """Nothing falls but the step sizes."""
        return {}

    def take_step(self, batch: TensorDictBase, number: int) -> Mapping[str, Tensor]:  # noqa: ARG002
        """Make one update of the critics, of the actor, of alpha and of the targets."""
        loss, _ = self.loss.qvalue_v2_loss(batch)
        self.descend(loss, self.critic_parameters)
        actor_loss, found = self.loss.actor_loss(batch)
        alpha = self.loss.log_alpha.detach().exp()
        alpha_loss = self.loss.alpha_loss(found["log_prob"]).mean()
        self.descend(actor_loss + alpha_loss, self.actor_parameters)
        self.target_updater.step()
        return {
            "loss": loss.detach(),
            "actor_loss": actor_loss.detach(),
            "alpha": alpha,
            "entropy": -found["log_prob"].mean(),
        }
