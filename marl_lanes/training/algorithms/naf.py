"""NAF as an algorithm of the learner, and its configuration."""

from collections.abc import Mapping
from typing import Literal

import torch
from pydantic import Field
from tensordict import TensorDictBase
from torch import Tensor, nn
from torch.nn.utils import clip_grad_norm_
from torchrl.objectives import HardUpdate

from marl_lanes.envs.batched import LaneChangeEnv
from marl_lanes.naf.joined import join_parameters
from marl_lanes.naf.loss import NAFLoss
from marl_lanes.naf.network import NAFNetwork
from marl_lanes.naf.updater import ForeachSoftUpdate
from marl_lanes.scenario.fields import Real, Section
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.training.algorithms.algorithm import Algorithm
from marl_lanes.training.algorithms.exploration import NoisyActor
from marl_lanes.training.config import (
    ChangersConfig,
    CountOrZero,
    DistributedCollectorConfig,
    LearnerConfig,
    Magnitude,
    Number,
    OptimizerConfig,
    Widths,
)
from marl_lanes.training.transitions import CPU


class NAFLossConfig(Section):
    """NAFLoss and its target network."""

    gamma: Real = Field(ge=0.0, le=1.0, description="discount factor")
    target_update: Literal["soft", "hard"] = Field(
        description="soft: Polyak averaging by tau; hard: a copy"
    )
    tau: Real = Field(gt=0.0, le=1.0, description="step of the soft update")
    target_interval: Number = Field(description="updates of the network for one of the target")


class NAFOptimizerConfig(OptimizerConfig):
    """Adam for M, V and an encoder, and for mu; the step sizes fall through stage two."""

    mu_learning_rate: Magnitude = Field(
        description="step size of mu: smaller, V keeps up with the policy that it has to value"
    )
    pretraining_transitions: CountOrZero = Field(
        description="length of stage one, which trains M and V alone"
    )
    compile: bool = Field(
        description="whether the loss goes through torch.compile; the first update then takes a "
        "minute"
    )


class NAFConfig(LearnerConfig):
    """How one group learns with NAF."""

    loss: NAFLossConfig
    optimizer: NAFOptimizerConfig


class NetworkConfig(Section):
    """Form of the changers' NAF network."""

    mu: str = Field(
        description="cascade, paper, damped or mlp; with two actions the first three with +idm or "
        "+mlp, or mlp"
    )
    encoder: Literal["none", "gru", "grid"] = Field(
        description="what the networks see: none: the observation; gru: the newest of stacked "
        "observations and the state of a GRU over all of them; grid: the features and a "
        "convolution of the occupancy grid"
    )
    knows_action_cost: bool = Field(
        description="whether Q has the reward's own cost of the yaw acceleration in it; with mu "
        "cascade alone"
    )
    hidden_sizes: Widths = Field(description="widths of the hidden layers of every network")


class TrainingConfig(NAFConfig, ChangersConfig):
    """Everything that defines a run of agents/naf/train.py."""

    collector: DistributedCollectorConfig
    recipe: str = Field(description="the recipe's name")
    network: NetworkConfig
    initial_checkpoint: str | None = Field(
        description="a checkpoint whose weights the training starts from; null: from none"
    )


class NAF(Algorithm):
    """Normalized advantage functions in two stages: first M and V learn, then mu, too.

    Args:
        config: its settings.
        env: the environment that collects, or the pattern of the workers' environments.
        network: the group's network; it is moved to the device and changed in place.
        group: name of the group of agents.
        device: where the network learns.
        acting_device: where it acts; in workers on the CPU.
    """

    columns = ("stage", "loss", "sigma")

    def __init__(
        self,
        config: NAFConfig,
        env: LaneChangeEnv,
        network: NAFNetwork,
        *,
        group: str = CHANGER.group,
        device: torch.device = CPU,
        acting_device: torch.device = CPU,
    ) -> None:
        self.config = config
        self.pretraining_transitions = config.optimizer.pretraining_transitions
        self.network: NAFNetwork = network.to(device)
        self.group = group
        self.device = device
        # One tensor for parameters that learn together: the optimizer's cost is mostly per tensor.
        others = (network.factor_logits, network.value, network.encoder)
        parts = [parameter for part in others for parameter in part.parameters()]
        self.joined = [join_parameters(part) for part in (parts, list(network.mu.parameters()))]
        self.gradients = [block.grad for block in self.joined if block.grad is not None]
        rates: dict[float, list[nn.Parameter]] = {}
        steps = config.optimizer.learning_rate, config.optimizer.mu_learning_rate
        for block, rate in zip(self.joined, steps, strict=True):
            rates.setdefault(rate, []).append(block)
        self.rates = tuple(rates)
        self.loss = NAFLoss(network)
        self.loss.make_value_estimator(gamma=config.loss.gamma)
        if config.loss.target_update == "soft":
            self.target_updater = ForeachSoftUpdate(self.loss, tau=config.loss.tau)
        else:
            # An interval of 0 calls between two copies: ``step`` is called only when one is due.
            self.target_updater = HardUpdate(self.loss, value_network_update_interval=0)
        self.optimizer = torch.optim.Adam(
            [{"params": blocks, "lr": rate} for rate, blocks in rates.items()], fused=True
        )
        self.compute_loss = torch.compile(self.loss) if config.optimizer.compile else self.loss
        self.actor = NoisyActor(config.exploration, env, network, group, device, acting_device)
        self.policy = self.actor.policy

    def refresh_policy(self) -> None:
        """Copy the learned weights to the policy, if it has its own."""
        self.actor.refresh()

    def anneal(self, transitions: int) -> None:
        """Set noise, step sizes and stage, given the number of transitions so far."""
        self.actor.anneal(transitions)
        optimizer, stage_one = self.config.optimizer, self.pretraining_transitions
        stage_two = max(1, self.config.collector.total_transitions - stage_one)
        share = min(1.0, max(0, transitions - stage_one) / stage_two)
        for group, rate in zip(self.optimizer.param_groups, self.rates, strict=True):
            group["lr"] = rate * (1.0 - share * (1.0 - optimizer.final_rate))
        is_stage_one = transitions < stage_one
        # Adam passes over what has no gradient; a zero one it would count as a step.
        self.joined[1].grad = None if is_stage_one else self.gradients[1]
        self.network.mu_frozen = is_stage_one
        self.loss.value_network.mu_frozen = is_stage_one

    def schedules(self) -> Mapping[str, float]:
        """The stage, and the noise as a share of each half range."""
        return {"stage": 1 if self.network.mu_frozen else 2, "sigma": self.actor.sigma}

    def take_step(self, batch: TensorDictBase, number: int) -> Mapping[str, Tensor]:
        """Make one update of the network, and of the target if it is due."""
        for gradient in self.gradients:
            gradient.zero_()
        loss: Tensor = self.compute_loss(batch)["loss"]
        loss.backward()
        if self.config.optimizer.max_gradient_norm is not None:
            clip_grad_norm_(self.joined, self.config.optimizer.max_gradient_norm, foreach=True)
        self.optimizer.step()
        if number % self.config.loss.target_interval == 0:
            self.target_updater.step()
        return {"loss": loss.detach()}
