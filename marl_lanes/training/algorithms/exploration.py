"""How agents act while transitions are collected: with noise, or drawn from a distribution."""

import copy

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import (
    ProbabilisticTensorDictSequential,
    TensorDictModuleBase,
    TensorDictSequential,
)
from torch import Tensor, nn
from torchrl.modules import AdditiveGaussianModule

from marl_lanes.envs.batched import LaneChangeEnv
from marl_lanes.naf.checkpoint import PolicyNetwork
from marl_lanes.training.config import ExplorationConfig
from marl_lanes.training.transitions import CPU, LivePolicy


class OccasionalNoise(TensorDictModuleBase):
    """Noise on the actions of some agents in a step, drawn anew in every step; the others' stay.

    The steps after a noisy action are then mostly greedy, so that what comes of it is what the
    policy makes of it. And where the action is mu, Q is V, whatever the shape of Q is elsewhere.

    Args:
        noise: writes noisy actions over the greedy ones.
        action_key: of the actions, (..., A, D).
        probability: of noise, for an agent in a step [1].
    """

    def __init__(
        self, noise: AdditiveGaussianModule, action_key: tuple[str, str], probability: float
    ) -> None:
        super().__init__()
        self.noise = noise
        self.action_key = action_key
        self.probability = probability
        self.in_keys = [action_key]
        self.out_keys = [action_key]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the actions over the greedy ones."""
        greedy = tensordict[self.action_key].clone()
        noisy = self.noise(tensordict)[self.action_key]
        # Drawn in the actions' dtype: torch's default one may be set to another.
        drawn = torch.rand(greedy.shape[:-1], dtype=greedy.dtype, device=greedy.device)
        is_noisy = drawn < self.probability
        tensordict[self.action_key] = torch.where(is_noisy.unsqueeze(-1), noisy, greedy)
        return tensordict


class NoisyActor:
    """A network's greedy policy with noise that decreases.

    Args:
        config: settings of the noise.
        env: the noisy actions are clipped to its bounds.
        network: the network that learns.
        group: name of the group of agents.
        device: device of the network.
        acting_device: where the policy acts; on another device it acts with a copy of the network.

    Attributes:
        network: the network that acts: the given one, or its copy.
        noise: TorchRL's module.
        policy: writes the group's actions, with noise.
    """

    def __init__(
        self,
        config: ExplorationConfig,
        env: LaneChangeEnv,
        network: PolicyNetwork,
        group: str,
        device: torch.device,
        acting_device: torch.device,
    ) -> None:
        self.config = config
        self._learning = network
        self.network = (
            network if acting_device == device else copy.deepcopy(network).to(acting_device)
        )
        self.noise = AdditiveGaussianModule(
            spec=env.full_action_spec,
            action_key=(group, "action"),
            sigma_init=config.initial_sigma,
            sigma_end=config.final_sigma,
        ).to(torch.float32)
        # Sigma is a share of the half range, whatever the action's unit.
        self.noise.std = network.box.half_range.to(CPU, copy=True)
        self.noise.std[1:] *= config.longitudinal_factor
        greedy = LivePolicy(
            self.network.policy().module, len(self.noise.std), group, device=acting_device
        )
        noise = self.noise
        if config.probability < 1.0:
            noise = OccasionalNoise(self.noise, (group, "action"), config.probability)
        self.policy = TensorDictSequential(greedy, noise)

    @property
    def sigma(self) -> float:
        """Standard deviation of the noise, as a share of each action's half range [1]."""
        return float(self.noise.sigma)

    def refresh(self) -> None:
        """Copy the learned weights, if it acts with a copy."""
        if self.network is not self._learning:
            self.network.load_state_dict(self._learning.state_dict())

    def anneal(self, transitions: int) -> None:
        """Set the noise, given the number of transitions so far."""
        config = self.config
        share = min(1.0, transitions / max(1, config.annealing_transitions))
        sigma = config.initial_sigma
        self.noise.sigma.fill_(sigma + share * (config.final_sigma - sigma))


class Sampler(nn.Module):
    """Observations (N, F) to actions (N, D) drawn from their distribution."""

    def __init__(self, policy: ProbabilisticTensorDictSequential) -> None:
        super().__init__()
        self.policy = policy

    def forward(self, observation: Tensor) -> Tensor:
        """The actions."""
        seen = TensorDict({"observation": observation}, [len(observation)])
        action: Tensor = self.policy.get_dist(seen).sample()
        return action


class SamplingActor:
    """A policy that draws its actions.

    Args:
        policy: that learns.
        action_dim: D.
        group: name of the group of agents.
        device: device of the policy.
        acting_device: where it acts; on another device it acts with a copy.

    Attributes:
        policy: writes the group's actions.
    """

    def __init__(
        self,
        policy: ProbabilisticTensorDictSequential,
        action_dim: int,
        group: str,
        device: torch.device,
        acting_device: torch.device,
    ) -> None:
        self._learning = policy
        self._acting = (
            policy if acting_device == device else copy.deepcopy(policy).to(acting_device)
        )
        sampler = Sampler(self._acting)
        self.policy = TensorDictSequential(
            LivePolicy(sampler, action_dim, group, device=acting_device)
        )

    def refresh(self) -> None:
        """Copy the learned weights, if it acts with a copy."""
        if self._acting is not self._learning:
            self._acting.load_state_dict(self._learning.state_dict())
