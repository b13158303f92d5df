"""The greedy action mu(s) of the quadratic Q-function: three structures and what they share.

Every mu maps the raw observation, for the columns of its formula, and the normalised one, for its
networks, to an action inside the box. In the maneuver frame the lateral deviation is reference
minus position, positive at the start; yaw and yaw rate are positive toward the target, so that
d(deviation)/dt = -speed sin(yaw); the action is the yaw acceleration.
"""

import itertools
from collections.abc import Callable, Sequence
from math import expm1, log

import torch
from torch import Tensor, nn
from torch.nn.functional import softplus

# The share of the action bound below which a_max does not fall: a_max is a divisor.
A_MAX_FLOOR = 0.01


class ActionBox(nn.Module):
    """The box low <= a <= high of admissible actions.

    Args:
        low: lower bounds, (action_dim,), in action units.
        high: upper bounds, (action_dim,), each above its lower bound.

    Raises:
        ValueError: the bounds are not two finite, ordered vectors of one length.
    """

    low: Tensor
    high: Tensor

    def __init__(self, low: Sequence[float] | Tensor, high: Sequence[float] | Tensor) -> None:
        super().__init__()
        lower, upper = (torch.as_tensor(bound, dtype=torch.float32) for bound in (low, high))
        if lower.ndim != 1 or lower.shape != upper.shape or not lower.numel():
            raise ValueError(
                "action_low and action_high must be vectors of one length, "
                f"got shapes {tuple(lower.shape)} and {tuple(upper.shape)}"
            )
        if not (torch.isfinite(upper - lower) & (lower < upper)).all():
            raise ValueError(f"need finite action_low < action_high, got {low} and {high}")
        self.register_buffer("low", lower)
        self.register_buffer("high", upper)

    @property
    def half_range(self) -> Tensor:
        """(high - low) / 2, (action_dim,), in action units."""
        return (self.high - self.low) / 2

    @property
    def centre(self) -> Tensor:
        """(high + low) / 2, (action_dim,), in action units."""
        return (self.high + self.low) / 2

    def forward(self, action: Tensor) -> Tensor:
        """The nearest point of the box, (..., action_dim)."""
        return action.clamp(self.low, self.high)


class Heads(nn.Module):
    """Tanh networks side by side, whose outputs start near given values, whatever the input.

    They have no weights in common; one batched product a layer evaluates them together, which for
    networks of this size costs little more than one of them.

    Args:
        in_features: length of the input.
        hidden_sizes: widths of the hidden layers of each network.
        initial: initial outputs, for each network the same number of them.
    """

    # Small, not zero: with zero weights the hidden layers would get no gradient at first.
    LAST_GAIN = 0.01

    def __init__(
        self, in_features: int, hidden_sizes: Sequence[int], initial: Sequence[Sequence[float]]
    ) -> None:
        super().__init__()
        self.initial = [list(values) for values in initial]
        widths = [in_features, *hidden_sizes, len(self.initial[0])]
        self.num_layers = len(widths) - 1
        for layer, (fan_in, fan_out) in enumerate(itertools.pairwise(widths)):
            weight = torch.empty(len(self.initial), fan_in, fan_out)
            self.register_parameter(f"weight_{layer}", nn.Parameter(weight))
            bias = torch.empty(len(self.initial), 1, fan_out)
            self.register_parameter(f"bias_{layer}", nn.Parameter(bias))
        self.reset_parameters()

    def layer(self, index: int) -> tuple[Tensor, Tensor]:
        """Weight (networks, in, out) and bias (networks, 1, out) of a layer."""
        return getattr(self, f"weight_{index}"), getattr(self, f"bias_{index}")

    @property
    def last_bias(self) -> Tensor:
        """Bias of the last layer, (networks, 1, outputs)."""
        return self.layer(self.num_layers - 1)[1]

    def reset_parameters(self) -> None:
        """Draws the weights anew and sets the last layer back to the initial outputs."""
        with torch.no_grad():
            for index in range(self.num_layers):
                weight, bias = self.layer(index)
                bound = weight.shape[1] ** -0.5  # that of nn.Linear
                weight.uniform_(-bound, bound)
                bias.uniform_(-bound, bound)
            weight.mul_(self.LAST_GAIN)
            bias.copy_(torch.tensor(self.initial).unsqueeze(1))

    def forward(self, observation: Tensor) -> Tensor:
        """(..., in_features) to (..., networks * outputs), network by network."""
        rows = observation.flatten(end_dim=-2) if observation.ndim > 1 else observation[None]
        hidden = rows.expand(len(self.initial), -1, -1)
        for index in range(self.num_layers):
            weight, bias = self.layer(index)
            hidden = torch.baddbmm(bias, hidden, weight)
            if index < self.num_layers - 1:
                hidden = torch.tanh(hidden)
        width = hidden.shape[0] * hidden.shape[2]
        return hidden.transpose(0, 1).reshape(*observation.shape[:-1], width)


class Mu(nn.Module):
    """A structure of the greedy action.

    Attributes:
        inside_box: no parameters and no observation take the action out of the box, so that the
            maximum of Q over the box is V itself.
        needs: names of the observation columns that the formula reads.
    """

    inside_box = True
    needs: tuple[str, ...] = ()

    def __init__(self, name: str, features: Sequence[str]) -> None:
        super().__init__()
        for feature in self.needs:
            if feature not in features:
                raise ValueError(
                    f"mu {name!r} needs the feature {feature!r}, got {', '.join(features)}"
                )
        self.columns = [list(features).index(feature) for feature in self.needs]

    def read(self, observation: Tensor) -> list[Tensor]:
        """The columns that the formula needs, each (..., 1), in the order of `needs`."""
        return [observation[..., column : column + 1] for column in self.columns]


class _YawAcceleration(Mu):
    """A formula for one action, a yaw acceleration about zero, with a learned limit a_max."""

    initial_a_max: float

    def __init__(self, name: str, features: Sequence[str], box: ActionBox) -> None:
        super().__init__(name, features)
        if box.low.numel() != 1:
            raise ValueError(
                f"mu {name!r} gives one action, the yaw acceleration; with {box.low.numel()} "
                "actions only mu 'mlp' is allowed"
            )
        self.bound = min(-box.low.item(), box.high.item())
        if self.bound <= 0:
            raise ValueError(f"mu {name!r} needs an action box with zero inside")

    def initial_limit_logit(self) -> float:
        """What `limit` maps to the initial a_max."""
        share = min(self.initial_a_max / self.bound, 0.9)
        return _logit(max((share - A_MAX_FLOOR) / (1 - A_MAX_FLOOR), A_MAX_FLOOR))

    def limit(self, logit: Tensor) -> Tensor:
        """a_max in (0, bound] [rad/s^2]."""
        return self.bound * (A_MAX_FLOOR + (1 - A_MAX_FLOOR) * torch.sigmoid(logit))


class PaperMu(_YawAcceleration):
    """a = a_max tanh(beta (deviation / T^2 - speed yaw / T)).

    Three networks give a_max, the sensitivity beta > 0 [s^2/m] and the transition time
    T > 1.5 s, initially 0.25 rad/s^2, 0.31 and 3.4 s. It has no yaw-rate term: it turns a vehicle
    into the target lane, but no gains let it settle there.

    Source: Eq. 6-7; the sign of the yaw term follows the module's frame.
    """

    needs = ("speed", "lateral_deviation", "yaw")
    initial_a_max = 0.25
    min_time = 1.5

    def __init__(
        self, name: str, features: Sequence[str], box: ActionBox, hidden_sizes: Sequence[int]
    ) -> None:
        super().__init__(name, features, box)
        initial = (
            self.initial_limit_logit(),
            _inverse_softplus(0.31),
            _inverse_softplus(3.4 - self.min_time),
        )
        # The three networks of a_max, beta and T, one output each.
        self.heads = Heads(len(features), hidden_sizes, [[value] for value in initial])

    def forward(self, observation: Tensor, normalised: Tensor) -> Tensor:
        """The greedy yaw acceleration, (..., 1) [rad/s^2]."""
        speed, deviation, yaw = self.read(observation)
        limit, beta, time = self.heads(normalised).split(1, dim=-1)
        beta = softplus(beta)
        time = self.min_time + softplus(time)
        # One factor 1/T taken out, so that a huge T does not overflow its square.
        demand = (deviation / time - speed * yaw) / time
        return self.limit(limit) * torch.tanh(beta * demand)


class DampedMu(_YawAcceleration):
    """a = a_max tanh(u / a_max), u = k0 deviation / speed - k1 yaw - k2 relative_yaw_rate.

    relative_yaw_rate is yaw_rate - curvature speed; the speed that divides is 1 m/s or more. The
    gains k0 = p1 p2 p3, k1 = p1 p2 + p1 p3 + p2 p3, k2 = p1 + p2 + p3 place the poles of the
    linear loop at -p1, -p2, -p3, each in [0.4, 2.4] rad/s: it settles whatever is learned.
    Four networks give the poles, initially 1.4 rad/s each, and a_max, initially 0.17 rad/s^2.
    """

    needs = ("speed", "lateral_deviation", "yaw", "yaw_rate", "curvature")
    initial_a_max = 0.17
    slowest_pole, fastest_pole = 0.4, 2.4
    min_speed = 1.0

    def __init__(
        self, name: str, features: Sequence[str], box: ActionBox, hidden_sizes: Sequence[int]
    ) -> None:
        super().__init__(name, features, box)
        # Networks of a_max and of each pole; the logits 0 are the middle of the poles' range.
        initial = (self.initial_limit_logit(), 0.0, 0.0, 0.0)
        self.heads = Heads(len(features), hidden_sizes, [[value] for value in initial])

    def forward(self, observation: Tensor, normalised: Tensor) -> Tensor:
        """The greedy yaw acceleration, (..., 1) [rad/s^2]."""
        speed, deviation, yaw, yaw_rate, curvature = self.read(observation)
        span = self.fastest_pole - self.slowest_pole
        limit, *logits = self.heads(normalised).split(1, dim=-1)
        p1, p2, p3 = (self.slowest_pole + span * torch.sigmoid(logit) for logit in logits)
        demand = (
            p1 * p2 * p3 * deviation / speed.clamp(min=self.min_speed)
            - (p1 * p2 + p1 * p3 + p2 * p3) * yaw
            - (p1 + p2 + p3) * (yaw_rate - curvature * speed)
        )
        limit = self.limit(limit)
        return limit * torch.tanh(demand / limit)


class MLPMu(Mu):
    """a = centre + half_range tanh(network(s)), for any number of actions; initially the centre."""

    def __init__(
        self, name: str, features: Sequence[str], box: ActionBox, hidden_sizes: Sequence[int]
    ) -> None:
        super().__init__(name, features)
        self.box = box
        self.action = Heads(len(features), hidden_sizes, [[0.0] * box.low.numel()])

    def forward(self, observation: Tensor, normalised: Tensor) -> Tensor:  # noqa: ARG002
        """The greedy action, (..., action_dim)."""
        return self.box.centre + self.box.half_range * torch.tanh(self.action(normalised))


STRUCTURES: dict[str, Callable[[str, Sequence[str], ActionBox, Sequence[int]], Mu]] = {
    "paper": PaperMu,
    "damped": DampedMu,
    "mlp": MLPMu,
}


def make_mu(name: str, features: Sequence[str], box: ActionBox, hidden_sizes: Sequence[int]) -> Mu:
    """The structure of that name.

    Args:
        name: "paper", "damped" or "mlp".
        features: names of the observation's columns.
        box: the admissible actions.
        hidden_sizes: widths of the hidden layers of each of its networks.

    Raises:
        ValueError: the name is unknown, a column is missing, or the box does not fit.
    """
    if name not in STRUCTURES:
        raise ValueError(f"unknown mu {name!r}, allowed: {', '.join(STRUCTURES)}")
    return STRUCTURES[name](name, features, box, hidden_sizes)


def _logit(share: float) -> float:
    return log(share / (1 - share))


def _inverse_softplus(value: float) -> float:
    return log(expm1(value))
