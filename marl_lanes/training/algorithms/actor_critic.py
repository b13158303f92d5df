"""Actor and critic networks without structure, and distributions of actions about an actor's."""

from collections.abc import Sequence
from typing import Any

import torch
from tensordict.nn import (
    ProbabilisticTensorDictModule,
    ProbabilisticTensorDictSequential,
    TensorDictModule,
)
from torch import Tensor, nn
from torchrl.modules import MLP, IndependentNormal, TanhNormal

from marl_lanes.naf.layers import ActionBox
from marl_lanes.naf.network import Normaliser

FIRST_SHARE = 0.01
"""Factor of the initial weights of an actor's last layer: its first actions are near zero."""

LARGEST_SHARE = 0.9
"""[1] Of the half range, of the first actions: where the box does not hold zero."""

LOG_SCALE = (-7.0, 1.0)
"""Bounds of the logarithm of a standard deviation that depends on the state."""


class ActorNetwork(nn.Module):
    """a = centre + half_range tanh(f(s)), f a ReLU network of the normalised observation.

    The first actions are near zero, which need not be the centre: that of an acceleration with more
    room for braking is a brake.

    Args:
        features: names of the observation's columns.
        action_low: lower bounds of the action, (action_dim,), in action units.
        action_high: upper bounds of the action, (action_dim,).
        hidden_sizes: widths of the hidden layers.
        offsets: observation offsets, one a feature, in its unit; zeros where not given.
        scales: observation scales, one a feature, positive, in its unit; ones where not given.

    Raises:
        ValueError: lengths, bounds or scales are inconsistent.
    """

    def __init__(
        self,
        features: Sequence[str],
        action_low: Sequence[float],
        action_high: Sequence[float],
        *,
        hidden_sizes: Sequence[int] = (64, 64),
        offsets: Sequence[float] | None = None,
        scales: Sequence[float] | None = None,
    ) -> None:
        super().__init__()
        self.features = list(features)
        self.hidden_sizes = list(hidden_sizes)
        self.box = ActionBox(action_low, action_high)
        self.normalise = Normaliser(self.features, offsets, scales)
        self.layers = MLP(
            in_features=len(self.features),
            out_features=self.box.low.numel(),
            num_cells=self.hidden_sizes,
            activation_class=nn.ReLU,
            layer_kwargs={"dtype": torch.float32},
        )
        last = self.layers[-1]
        with torch.no_grad():
            last.weight.mul_(FIRST_SHARE)
            zero = -self.box.centre / self.box.half_range
            last.bias.copy_(zero.clamp(-LARGEST_SHARE, LARGEST_SHARE).atanh())

    @property
    def config(self) -> dict[str, Any]:
        """Constructor arguments in plain Python types: ActorNetwork(**config) has the same form."""
        return {
            "features": list(self.features),
            "action_low": self.box.low.tolist(),
            "action_high": self.box.high.tolist(),
            "hidden_sizes": list(self.hidden_sizes),
            "offsets": self.normalise.offset.tolist(),
            "scales": self.normalise.scale.tolist(),
        }

    def forward(self, observation: Tensor) -> Tensor:
        """The action, (..., action_dim), within the box.

        Args:
            observation: (..., len(features)).
        """
        share = torch.tanh(self.location(observation))
        # Rounding may put it outside the box.
        action: Tensor = self.box(self.box.centre + self.box.half_range * share)
        return action

    def location(self, observation: Tensor) -> Tensor:
        """f(s), (..., action_dim) [1]."""
        location: Tensor = self.layers(self.normalise(observation))
        return location

    def policy(self) -> TensorDictModule:
        """The network as a TensorDict module."""
        return TensorDictModule(self, in_keys=["observation"], out_keys=["action"])


class CriticNetwork(nn.Module):
    """Q(s, a), a ReLU network of the normalised observation and of the action's share of its range.

    Args:
        actor: the critic takes its features, scales and bounds, but shares no parameters with it.
        hidden_sizes: widths of the hidden layers.
    """

    def __init__(self, actor: ActorNetwork, hidden_sizes: Sequence[int]) -> None:
        super().__init__()
        config = actor.config
        self.box = ActionBox(config["action_low"], config["action_high"])
        self.normalise = Normaliser(config["features"], config["offsets"], config["scales"])
        self.layers = MLP(
            in_features=len(actor.features) + self.box.low.numel(),
            out_features=1,
            num_cells=list(hidden_sizes),
            activation_class=nn.ReLU,
            layer_kwargs={"dtype": torch.float32},
        )

    def forward(self, observation: Tensor, action: Tensor) -> Tensor:
        """State-action values, (..., 1).

        Args:
            observation: (..., features).
            action: (..., action_dim), in action units.
        """
        share = (action - self.box.centre) / self.box.half_range
        value: Tensor = self.layers(torch.cat([self.normalise(observation), share], dim=-1))
        return value


class ValueNetwork(nn.Module):
    """V(s), a tanh network of the normalised observation and of more, where more is given.

    Args:
        actor: the critic takes its features and scales, but shares no parameters with it.
        hidden_sizes: widths of the hidden layers.
        num_more: length of what is given besides.
    """

    def __init__(self, actor: ActorNetwork, hidden_sizes: Sequence[int], num_more: int = 0) -> None:
        super().__init__()
        config = actor.config
        self.normalise = Normaliser(config["features"], config["offsets"], config["scales"])
        self.layers = MLP(
            in_features=len(actor.features) + num_more,
            out_features=1,
            num_cells=list(hidden_sizes),
            activation_class=nn.Tanh,
            layer_kwargs={"dtype": torch.float32},
        )

    def forward(self, observation: Tensor, *more: Tensor) -> Tensor:
        """State values, (..., 1).

        Args:
            observation: (..., features).
            *more: (..., num_more) [1], if there is more.
        """
        value: Tensor = self.layers(torch.cat([self.normalise(observation), *more], dim=-1))
        return value


class Gaussian(nn.Module):
    """A normal distribution about the actor's action; its width does not depend on the state.

    Args:
        actor: the mean; its parameters are learned, too.
        sigma: initial standard deviation of each action, (action_dim,), in action units.
    """

    def __init__(self, actor: ActorNetwork, sigma: Tensor) -> None:
        super().__init__()
        self.actor = actor
        self.log_sigma = nn.Parameter(sigma.log())

    def forward(self, observation: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and standard deviation, (..., action_dim) each, in action units."""
        mean: Tensor = self.actor(observation)
        return mean, self.log_sigma.exp().expand_as(mean)

    def policy(self) -> ProbabilisticTensorDictSequential:
        """Observations to actions drawn from the distribution, not clipped to the box."""
        return _draw(self, IndependentNormal)


class SquashedGaussian(nn.Module):
    """A normal distribution about f(s), squashed into the box as the actor squashes f(s) itself.

    Args:
        actor: of f; its parameters are learned, too.
        hidden_sizes: widths of the hidden layers of the standard deviation's network.
        sigma: initial standard deviation of each action, (action_dim,), before squashing [1].
    """

    def __init__(self, actor: ActorNetwork, hidden_sizes: Sequence[int], sigma: Tensor) -> None:
        super().__init__()
        self.actor = actor
        self.log_scale = MLP(
            in_features=len(actor.features),
            out_features=sigma.numel(),
            num_cells=list(hidden_sizes),
            activation_class=nn.ReLU,
            layer_kwargs={"dtype": torch.float32},
        )
        last = self.log_scale[-1]
        with torch.no_grad():
            last.weight.mul_(FIRST_SHARE)
            last.bias.copy_(sigma.log())

    def forward(self, observation: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and standard deviation before squashing, (..., action_dim) each [1]."""
        log_scale = self.log_scale(self.actor.normalise(observation)).clamp(*LOG_SCALE)
        return self.actor.location(observation), log_scale.exp()

    def policy(self) -> ProbabilisticTensorDictSequential:
        """Observations to actions drawn from the distribution, within the box."""
        box = self.actor.box
        return _draw(self, TanhNormal, low=box.low, high=box.high, safe_tanh=True)


def _draw(
    parameters: nn.Module, distribution: type[torch.distributions.Distribution], **options: Any
) -> ProbabilisticTensorDictSequential:
    return ProbabilisticTensorDictSequential(
        TensorDictModule(parameters, in_keys=["observation"], out_keys=["loc", "scale"]),
        ProbabilisticTensorDictModule(
            in_keys=["loc", "scale"],
            out_keys=["action"],
            distribution_class=distribution,
            distribution_kwargs=options,
            return_log_prob=True,
        ),
    )
