"""Actor and critic networks without structure, for losses of deterministic policies."""

from collections.abc import Sequence
from typing import Any

import torch
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.modules import MLP

from marl_lanes.naf.layers import ActionBox
from marl_lanes.naf.network import Normaliser

FIRST_SHARE = 0.01
"""Factor of the initial weights of an actor's last layer: its first actions are near the centre."""


class ActorNetwork(nn.Module):
    """a = centre + half_range tanh(f(s)), f a ReLU network of the normalised observation.

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
            last.bias.zero_()

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
        share = torch.tanh(self.layers(self.normalise(observation)))
        # Rounding may put it outside the box.
        action: Tensor = self.box(self.box.centre + self.box.half_range * share)
        return action

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
