"""NAF as an algorithm of the learner, and its configuration."""

from collections.abc import Mapping
from functools import partial
from typing import Literal

import torch
from pydantic import Field
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn
from torch.nn.utils import clip_grad_norm_, clip_grads_with_norm_
from torchrl.objectives import HardUpdate

from marl_lanes.envs.batched import LaneChangeEnv
from marl_lanes.naf.batched_loss import BatchedNAFLoss
from marl_lanes.naf.joined import join_parameters, joined_runs, take_side_by_side, whole_of
from marl_lanes.naf.loss import NAFLoss
from marl_lanes.naf.mu import ComposedMu
from marl_lanes.naf.network import NAFNetwork
from marl_lanes.naf.updater import ForeachSoftUpdate
from marl_lanes.scenario.fields import Real, Section
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.training.algorithms.algorithm import OffPolicy
from marl_lanes.training.algorithms.exploration import NoisyActor
from marl_lanes.training.algorithms.off_policy import set_rates
from marl_lanes.training.config import (
    ChangersConfig,
    CountOrZero,
    DistributedCollectorConfig,
    ExplorationConfig,
    Magnitude,
    Number,
    OffPolicyConfig,
    OffPolicyOptimizerConfig,
    Widths,
)
from marl_lanes.training.demonstrations import DemonstrationsConfig
from marl_lanes.training.graphs import Graphed, is_capturing
from marl_lanes.training.transitions import CPU, live_transitions


class NAFLossConfig(Section):
    """NAFLoss and its target network."""

    gamma: Real = Field(ge=0.0, le=1.0, description="discount factor")
    target_update: Literal["soft", "hard"] = Field(
        description="soft: Polyak averaging by tau; hard: a copy"
    )
    num_steps: Number = Field(
        le=1000,
        description="steps of reward before the target's value: more bring the value of an end "
        "sooner to the states before it; at most to the end of a collected batch",
    )
    tau: Real = Field(gt=0.0, le=1.0, description="step of the soft update")
    target_interval: Number = Field(description="updates of the network for one of the target")


class NAFOptimizerConfig(OffPolicyOptimizerConfig):
    """Adam for M, V and an encoder, and for mu; the step sizes fall through stage two."""

    mu_learning_rate: Magnitude = Field(
        description="step size of mu: smaller, V keeps up with the policy that it has to value"
    )
    longitudinal_learning_rate: Magnitude | None = Field(
        description="step size of the part of mu that accelerates, where it has one of its own; "
        "null: as mu_learning_rate"
    )
    pretraining_transitions: CountOrZero = Field(
        description="length of stage one, which trains M and V alone"
    )
    compile: bool = Field(
        description="whether the loss goes through torch.compile; the first update then takes a "
        "minute"
    )


class NAFConfig(OffPolicyConfig):
    """How one group learns with NAF."""

    loss: NAFLossConfig
    optimizer: NAFOptimizerConfig
    exploration: ExplorationConfig


class NetworkConfig(Section):
    """Form of the changers' NAF network."""

    mu: str = Field(
        description="cascade, cascade-smooth, cascade-gated, paper, damped or mlp; with two "
        "actions one of the first five with +idm or +mlp, or mlp"
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
    off_diagonal: bool = Field(
        description="whether M of two actions is a full matrix; otherwise it is diagonal"
    )
    hidden_sizes: Widths = Field(description="widths of the hidden layers of every network")


class TrainingConfig(NAFConfig, ChangersConfig):
    """Everything that defines a run of agents/naf/train.py."""

    collector: DistributedCollectorConfig
    recipe: str = Field(description="the recipe's name")
    network: NetworkConfig
    demonstrations: DemonstrationsConfig
    initial_checkpoint: str | None = Field(
        description="a checkpoint whose weights the training starts from; null: from none"
    )


class NAF(OffPolicy):
    """Normalized advantage functions in two stages: first M and V learn, then mu, too.

    Args:
        config: its settings.
        env: the environment that collects, or the pattern of the workers' environments.
        network: the group's network; it is moved to the device and changed in place.
        group: name of the group of agents.
        device: where the network learns.
        acting_device: where it acts; in workers on the CPU.
        is_batched: whether networks are evaluated together, in few large kernels. By default on a
            GPU alone: the sums of the CPU have another order, and a seed its published weights.
    """

    config: NAFConfig
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
        is_batched: bool | None = None,
    ) -> None:
        self.config = config
        self.pretraining_transitions = config.optimizer.pretraining_transitions
        self.network: NAFNetwork = network.to(device)
        self.group = group
        self.device = device
        self.parts = self._parts()
        # One tensor for parameters that learn together: the optimizer's cost is mostly per tensor.
        self.joined = [join_parameters(parameters) for parameters, _ in self.parts]
        self.gradients = [block.grad for block in self.joined if block.grad is not None]
        self.one = torch.ones((), device=device)
        rates: dict[float, list[nn.Parameter]] = {}
        for block, (_, rate) in zip(self.joined, self.parts, strict=True):
            rates.setdefault(rate, []).append(block)
        self.rates = tuple(rates)
        self.is_graphed = device.type == "cuda"
        self.is_batched = self.is_graphed if is_batched is None else is_batched
        self.loss = BatchedNAFLoss(network) if self.is_batched else NAFLoss(network)
        self.loss.make_value_estimator(gamma=config.loss.gamma)
        if config.loss.target_update == "soft":
            self.target_updater = ForeachSoftUpdate(self.loss, tau=config.loss.tau)
        else:
            # An interval of 0 calls between two copies: ``step`` is called only when one is due.
            self.target_updater = HardUpdate(self.loss, value_network_update_interval=0)
        if isinstance(self.loss, BatchedNAFLoss):
            self.loss.batch_networks(config.replay.batch_size)
        self.optimizer = torch.optim.Adam(
            [{"params": blocks, "lr": rate} for rate, blocks in rates.items()], fused=True
        )
        self.graphs: dict[tuple[bool, bool], Graphed] = {}
        # What a graph reads stays where it is.
        self.step_sizes = [torch.zeros((), device=device) for _ in rates]
        self.compute_loss = torch.compile(self.loss) if config.optimizer.compile else self.loss
        self.actor = NoisyActor(config.exploration, env, network, group, device, acting_device)
        self.policy = self.actor.policy

    def _parts(self) -> list[tuple[list[nn.Parameter], float]]:
        """Parameters that learn together, with their step sizes: mu's last."""
        network, optimizer = self.network, self.config.optimizer
        mu, rate = network.mu, optimizer.mu_learning_rate
        others = (network.factor_logits, network.value, network.encoder)
        critic = [parameter for part in others for parameter in part.parameters()]
        parts = [(critic, optimizer.learning_rate)]
        longitudinal = optimizer.longitudinal_learning_rate
        if longitudinal is None or not isinstance(mu, ComposedMu):
            return [*parts, (list(mu.parameters()), rate)]
        pieces = (mu.lateral, rate), (mu.longitudinal, longitudinal)
        return [*parts, *((list(piece.parameters()), step) for piece, step in pieces)]

    def take_in(self, batch: TensorDictBase) -> TensorDict:
        """The transitions of a collected batch, (N,), over ``loss.num_steps`` steps each."""
        loss = self.config.loss
        return live_transitions(batch, self.group, num_steps=loss.num_steps, gamma=loss.gamma)

    def refresh_policy(self) -> None:
        """Copy the learned weights to the policy, if it has its own."""
        self.actor.refresh()

    def anneal(self, transitions: int) -> None:
        """Set noise, step sizes and stage, given the number of transitions so far."""
        self.actor.anneal(transitions)
        optimizer, stage_one = self.config.optimizer, self.pretraining_transitions
        stage_two = max(1, self.config.collector.total_transitions - stage_one)
        share = min(1.0, max(0, transitions - stage_one) / stage_two)
        set_rates(self.optimizer, self.rates, optimizer, share)
        if self.is_graphed:
            for group, place in zip(self.optimizer.param_groups, self.step_sizes, strict=True):
                group["lr"] = place.fill_(group["lr"])
        is_stage_one = transitions < stage_one
        # Adam passes over what has no gradient; a zero one it would count as a step.
        for block, gradient in zip(self.joined[1:], self.gradients[1:], strict=True):
            block.grad = None if is_stage_one else gradient
        self.network.mu_frozen = is_stage_one
        self.loss.value_network.mu_frozen = is_stage_one

    def schedules(self) -> Mapping[str, float]:
        """The stage, and the noise as a share of each half range."""
        return {"stage": 1 if self.network.mu_frozen else 2, "sigma": self.actor.sigma}

    def take_step(self, batch: TensorDictBase, number: int) -> Mapping[str, Tensor]:
        """Make one update of the network, and of the target if it is due."""
        is_target_due = number % self.config.loss.target_interval == 0
        if not self.is_graphed:
            return dict(self._update(batch, is_target_due=is_target_due).items())
        choice = self.network.mu_frozen, is_target_due
        if choice not in self.graphs:
            update = partial(self._update, is_target_due=is_target_due)
            self.graphs[choice] = Graphed(update, [*self.loss.in_keys, "steps_to_next_obs"])
        return dict(self.graphs[choice](batch).clone().items())

    def _update(self, batch: TensorDictBase, *, is_target_due: bool) -> TensorDict:
        loss: Tensor = self.compute_loss(batch)["loss"]
        self._differentiate(loss)
        self._step()
        if is_target_due:
            self.target_updater.step()
        return TensorDict({"loss": loss.detach()}, [])

    def _differentiate(self, loss: Tensor) -> None:
        """Set the gradients of what learns, block by block: ``backward`` adds to each weight's."""
        learning = [
            (block, place, parameters)
            for block, place, (parameters, _) in zip(
                self.joined, self.gradients, self.parts, strict=True
            )
            if block.grad is not None
        ]
        weights = [weight for *_, parameters in learning for weight in parameters]
        found = iter(torch.autograd.grad(loss, weights, self.one, materialize_grads=True))
        for block, place, parameters in learning:
            gradients = [next(found) for _ in parameters]
            if self.is_batched:
                block.grad = take_side_by_side(gradients, place)
            else:
                torch.cat([gradient.flatten() for gradient in gradients], out=place)

    def _step(self) -> None:
        """Adam's step, by gradients that are no longer than allowed."""
        if self.config.optimizer.max_gradient_norm is not None:
            self._clip(self.config.optimizer.max_gradient_norm)
        # Said outside a capture, Adam would warn.
        for group in self.optimizer.param_groups:
            group["capturable"] = is_capturing()
        self.optimizer.step()

    def _clip(self, limit: float) -> None:
        gradients = [block.grad for block in self.joined if block.grad is not None]
        if self.is_batched and len(joined_runs(gradients)) == 1:
            norm = torch.linalg.vector_norm(whole_of(gradients))
            clip_grads_with_norm_(self.joined, limit, norm, foreach=True)
        else:
            clip_grad_norm_(self.joined, limit, foreach=True)
