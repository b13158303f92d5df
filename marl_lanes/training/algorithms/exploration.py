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
from torchrl.envs.utils import ExplorationType, exploration_type

from marl_lanes.envs.batched import LaneChangeEnv
from marl_lanes.naf.checkpoint import PolicyNetwork
from marl_lanes.naf.layers import ActionBox
from marl_lanes.training.config import ExplorationConfig
from marl_lanes.training.transitions import CPU, LivePolicy


class GaussianNoise(TensorDictModuleBase):
    """a + sigma std n, clipped to the box, n normal: noise on the greedy actions.

    With a probability below 1 it is on the actions of some agents in a step, drawn anew in every
    step; the others' stay. The steps after a noisy action are then mostly greedy, so that what
    comes of it is what the policy makes of it. And where the action is mu, Q is V, whatever the
    shape of Q is elsewhere.

    TorchRL's `AdditiveGaussianModule` gives the same actions, but looks at std and at the bounds
    on the host: on a GPU that is to wait twice a step. Like it, this one has no effect under
    ``ExplorationType.DETERMINISTIC``.

    Args:
        action_key: of the actions, (..., A, D).
        box: of the actions.
        std: of the noise where sigma is 1, (D,), in the actions' units.
        sigma: [1].
        probability: of noise, for an agent in a step [1].
    """

    sigma: Tensor
    std: Tensor
    low: Tensor
    high: Tensor

    def __init__(
        self,
        action_key: tuple[str, str],
        box: ActionBox,
        std: Tensor,
        sigma: float,
        probability: float = 1.0,
    ) -> None:
        super().__init__()
        self.action_key = action_key
        self.probability = probability
        self.in_keys = [action_key]
        self.out_keys = [action_key]
        self.register_buffer("sigma", torch.tensor(sigma, dtype=torch.float32, device=std.device))
        self.register_buffer("std", std)
        self.register_buffer("low", box.low.to(std.device, copy=True))
        self.register_buffer("high", box.high.to(std.device, copy=True))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the actions over the greedy ones."""
        if exploration_type() not in (ExplorationType.RANDOM, None):
            return tensordict
        greedy = tensordict[self.action_key]
        # Drawn in the actions' dtype: torch's default one may be set to another.
        options = {"dtype": greedy.dtype, "device": greedy.device}
        noise = torch.randn(greedy.shape, **options) * self.std
        noisy = (greedy + noise * self.sigma).clamp(self.low, self.high)
        if self.probability < 1.0:
            drawn = torch.rand(greedy.shape[:-1], **options)
            noisy = torch.where((drawn < self.probability).unsqueeze(-1), noisy, greedy)
        tensordict[self.action_key] = noisy
        return tensordict


class NoisyActor:
    """A network's greedy policy with noise that decreases.

    Args:
        config: settings of the noise.
        env: that it acts in, on the CPU or on the acting device.
        network: the network that learns; the noisy actions are clipped to its box.
        group: name of the group of agents.
        device: device of the network.
        acting_device: where the policy acts; on another device it acts with a copy of the network.

    Attributes:
        network: the network that acts: the given one, or its copy.
        noise: on the device of the environment.
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
        # Sigma is a share of the half range, whatever the action's unit.
        std = network.box.half_range.to(env.device or CPU, copy=True)
        std[1:] *= config.longitudinal_factor
        sigma = config.initial_sigma
        self.noise = GaussianNoise((group, "action"), network.box, std, sigma, config.probability)
        self.set_sigma(sigma)
        greedy = LivePolicy(self.network.policy().module, len(std), group, device=acting_device)
        self.policy = TensorDictSequential(greedy, self.noise)

    def set_sigma(self, sigma: float) -> None:
        """Set the noise's standard deviation, as a share of each action's half range [1]."""
        # Kept here as well: to read it back from a GPU is to wait.
        self.sigma = torch.tensor(sigma, dtype=torch.float32).item()
        self.noise.sigma.fill_(sigma)

    def refresh(self) -> None:
        """Copy the learned weights, if it acts with a copy."""
        if self.network is not self._learning:
            self.network.load_state_dict(self._learning.state_dict())

    def anneal(self, transitions: int) -> None:
        """Set the noise, given the number of transitions so far."""
        config = self.config
        share = min(1.0, transitions / max(1, config.annealing_transitions))
        start = config.initial_sigma
        self.set_sigma(start + share * (config.final_sigma - start))


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
