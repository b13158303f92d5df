"""PPO as an algorithm of the learner, with critics that see what the agent sees, or the road.

With parameters that all agents share and a critic of the agent's observation it is called IPPO,
with a critic of the road's state MAPPO.
"""

from collections.abc import Mapping
from pathlib import Path

import torch
from pydantic import Field
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torch.nn.utils import clip_grad_norm_
from torchrl.modules import ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value.functional import vec_generalized_advantage_estimate

from marl_lanes.envs.batched import LaneChangeEnv
from marl_lanes.envs.vehicle_table import state_columns
from marl_lanes.scenario.fields import NonNegative, Positive, Real, Section
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.training.algorithms.actor_critic import ActorNetwork, Gaussian, ValueNetwork
from marl_lanes.training.algorithms.algorithm import Algorithm
from marl_lanes.training.algorithms.exploration import SamplingActor
from marl_lanes.training.algorithms.off_policy import (
    ActorNetworkConfig,
    ActorOptimizerConfig,
    make_optimizer,
    parameters_of,
    set_rates,
)
from marl_lanes.training.config import Magnitude, OnPolicyConfig
from marl_lanes.training.experience import Epochs
from marl_lanes.training.transitions import CPU, live_transitions, send

STATE_SCALES = (500.0, 10.0, 20.0, 10.0, 0.3, 0.3, 20.0, 3.0)
"""In the units of ``state_columns`` without the last: what the critic sees as 1.

They are large: it sees hundreds of numbers of other vehicles, most of which do not matter.
"""

_NUM_RELATIVE = 3
"""Position, lateral position and speed, the first columns, are relative to the agent's."""


class PPOLossConfig(Section):
    """ClipPPOLoss and the advantages."""

    gamma: Real = Field(ge=0.0, le=1.0, description="discount factor")
    lmbda: Real = Field(ge=0.0, le=1.0, description="lambda of the generalised advantage estimate")
    clip_epsilon: Real = Field(
        gt=0.0, lt=1.0, description="the ratio of probabilities is clipped to 1 - and 1 + this"
    )
    entropy_weight: NonNegative = Field(le=1e6, description="weight of the entropy in the loss")


class DistributionConfig(Section):
    """Distribution of the actions, which learns its width."""

    initial_sigma: Magnitude = Field(
        description="standard deviation at the start, of each action's half range [1]"
    )
    longitudinal_factor: Positive = Field(
        le=1000.0,
        description="multiplies that of a second action, the longitudinal acceleration [1]",
    )


class PPOConfig(OnPolicyConfig):
    """How one group learns with PPO."""

    loss: PPOLossConfig
    optimizer: ActorOptimizerConfig
    network: ActorNetworkConfig
    exploration: DistributionConfig


class PPO(Algorithm):
    """Proximal policy optimisation with clipped ratios.

    The advantages are generalised advantage estimates over each agent's own steps: they end where
    its attempt ends, or with the batch. Steps of absent and waiting agents do not count.

    Args:
        config: its settings.
        env: the environment that collects, or the pattern of the workers' environments.
        network: the actor; it is moved to the device and changed in place.
        is_centralised: whether the critic sees the road's state, too; the environment must have it.
        group: name of the group of agents.
        device: where the networks learn.
        acting_device: where the actor acts; in workers on the CPU.

    Sources: Schulman et al. 2017, "Proximal Policy Optimization Algorithms"; de Witt et al. 2020,
    "Is Independent Learning All You Need in the StarCraft Multi-Agent Challenge?" (IPPO); Yu et al.
    2022, "The Surprising Effectiveness of PPO in Cooperative Multi-Agent Games" (MAPPO).
    """

    config: PPOConfig
    loss: ClipPPOLoss
    columns = ("loss", "actor_loss", "kl", "sigma")

    def __init__(
        self,
        config: PPOConfig,
        env: LaneChangeEnv,
        network: ActorNetwork,
        *,
        is_centralised: bool = False,
        group: str = CHANGER.group,
        device: torch.device = CPU,
        acting_device: torch.device = CPU,
    ) -> None:
        self.config = config
        self.network: ActorNetwork = network.to(device)
        self.group = group
        self.device = device
        self.is_centralised = is_centralised
        sigma = config.exploration.initial_sigma * network.box.half_range
        sigma[1:] *= config.exploration.longitudinal_factor
        self.gaussian = Gaussian(network, sigma)
        self.distribution = self.gaussian.policy()
        num_numbers = len(state_columns(env.scenario)) - 1
        num_more = env.scenario.max_vehicles * num_numbers if is_centralised else 0
        self.critic = ValueOperator(
            ValueNetwork(network, config.network.hidden_sizes, num_more),
            in_keys=["observation", "state"] if is_centralised else ["observation"],
        ).to(device)
        self.loss = ClipPPOLoss(
            self.distribution,
            self.critic,
            clip_epsilon=config.loss.clip_epsilon,
            entropy_coeff=config.loss.entropy_weight,
            critic_coeff=1.0,
            loss_critic_type="l2",
            normalize_advantage=True,
        )
        self.parts = [
            parameters_of(params)
            for params in (self.loss.critic_network_params, self.loss.actor_network_params)
        ]
        self.optimizer, self.rates = make_optimizer(config.optimizer, *self.parts)
        self.actor = SamplingActor(self.distribution, sigma.numel(), group, device, acting_device)
        self.policy = self.actor.policy

    def make_experience(self, folder: Path, bytes_per_transition: float) -> Epochs:  # noqa: ARG002
        """The newest batch alone."""
        return Epochs(self.config.epochs)

    def take_in(self, batch: TensorDictBase) -> TensorDict:
        """The transitions with the probabilities of their actions, advantages, and value targets.

        Args:
            batch: (E, T) or (N, E/N, T).
        """
        acting = batch[self.group, "acting"]
        rows = live_transitions(batch, self.group)
        if not len(rows):
            # Torch has no probabilities of no actions.
            return rows
        if self.is_centralised:
            rows["state"] = take_surroundings(batch["state"], acting)
            rows["next", "state"] = take_surroundings(batch["next", "state"], acting)
        rows = send(rows, self.device)
        with torch.no_grad():
            distribution = self.distribution.get_dist(rows)
            rows[self.loss.tensor_keys.sample_log_prob] = distribution.log_prob(rows["action"])
            values = [self.critic(one)["state_value"] for one in (rows, rows["next"])]
        after = rows["next"]
        columns = [*values, after["reward"], after["done"], after["terminated"]]
        acting = acting.to(self.device)
        # Each slot is a row in time. An attempt's last step is done, so whatever follows in the
        # slot, another agent or nobody, adds nothing to it.
        slots = [column.new_zeros((*acting.shape, 1)) for column in columns]
        for slot, column in zip(slots, columns, strict=True):
            slot[acting] = column
        found = vec_generalized_advantage_estimate(
            self.config.loss.gamma, self.config.loss.lmbda, *slots, time_dim=-3
        )
        rows["advantage"], rows["value_target"] = (one[acting] for one in found)
        return rows.exclude("next")

    def refresh_policy(self) -> None:
        """Copy the learned weights to the policy, if it has its own."""
        self.actor.refresh()

    def anneal(self, transitions: int) -> None:
        """Set the step sizes, given the number of transitions so far."""
        share = min(1.0, transitions / self.config.collector.total_transitions)
        set_rates(self.optimizer, self.rates, self.config.optimizer, share)

    def schedules(self) -> Mapping[str, float]:
        """The standard deviation of the first action, as a share of its half range."""
        sigma = self.gaussian.log_sigma.detach().exp() / self.network.box.half_range
        return {"sigma": float(sigma[0])}

    def take_step(self, batch: TensorDictBase, number: int) -> Mapping[str, Tensor]:  # noqa: ARG002
        """Make one update of critic and actor."""
        found = self.loss(batch)
        self.optimizer.zero_grad(set_to_none=True)
        (found["loss_objective"] + found["loss_critic"] + found["loss_entropy"]).backward()
        limit = self.config.optimizer.max_gradient_norm
        if limit is not None:
            for parameters in self.parts:
                clip_grad_norm_(parameters, limit, foreach=True)
        self.optimizer.step()
        return {
            "loss": found["loss_critic"].detach(),
            "actor_loss": found["loss_objective"].detach(),
            "kl": found["kl_approx"].detach(),
        }


def take_surroundings(states: Tensor, acting: Tensor) -> Tensor:
    """The road's state as each agent that acts sees it: all vehicles, the nearest first.

    Position, lateral position and speed are relative to the agent's vehicle. Rows without a vehicle
    are zero; all are, where the agent's vehicle is not on the road any more.

    Args:
        states: (..., V, columns) of the roads, with the columns ``state_columns``.
        acting: (..., A) bool.

    Returns:
        (N, V (columns - 1)) [1], in the order of ``states[acting]``.
    """
    *roads, slots = acting.nonzero(as_tuple=True)
    rows = states[tuple(roads)]
    is_own = rows[..., -1] == slots.unsqueeze(-1)
    numbers = rows[..., :-1]
    is_there = numbers.any(-1) & is_own.any(-1, keepdim=True)
    own = (numbers * is_own.unsqueeze(-1)).sum(-2, keepdim=True)
    own[..., _NUM_RELATIVE:] = 0.0
    seen = (numbers - own) / numbers.new_tensor(STATE_SCALES[: numbers.shape[-1]])
    distance = seen[..., 0].abs().where(is_there, torch.inf)
    seen = seen * is_there.unsqueeze(-1)
    order = distance.argsort(dim=-1, stable=True).unsqueeze(-1)
    return seen.take_along_dim(order, dim=-2).flatten(-2)
