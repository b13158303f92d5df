"""The greedy action mu(s) of the quadratic Q-function: its structures and what they share.

Every mu maps the raw observation, for the columns of its formula, and the normalised one, for its
networks, to an action inside the box. In the maneuver frame the lateral deviation is reference
minus position, positive at the start; yaw and yaw rate are positive toward the target, so that
d(deviation)/dt = -speed sin(yaw). The first action is the yaw acceleration [rad/s^2], a second one
the longitudinal acceleration [m/s^2].
"""

from collections.abc import Callable, Sequence
from math import expm1, log

import torch
from torch import Tensor, nn
from torch.nn.functional import softplus

from marl_lanes.naf.layers import ActionBox, Heads

# The share of the action bound below which a_max does not fall: a_max is a divisor.
A_MAX_FLOOR = 0.01


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
                f"mu {name!r} gives one action, the yaw acceleration, and the box has "
                f"{box.low.numel()}; allowed: {', '.join(_names_for(box.low.numel()))}"
            )
        self.bound = min(-box.low.item(), box.high.item())
        if self.bound <= 0:
            raise ValueError(
                f"mu {name!r} needs a yaw acceleration's bounds with zero inside, got "
                f"[{box.low.item():g}, {box.high.item():g}]"
            )

    def initial_limit_logit(self, floor: float = A_MAX_FLOOR) -> float:
        """What `limit` maps to the initial a_max."""
        share = min(self.initial_a_max / self.bound, 0.9)
        return _logit(max((share - floor) / (1 - floor), A_MAX_FLOOR))

    def limit(self, logit: Tensor, floor: Tensor | float = A_MAX_FLOOR) -> Tensor:
        """a_max between a share of the bound and the bound [rad/s^2]."""
        return self.bound * (floor + (1 - floor) * torch.sigmoid(logit))


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
    linear loop at -p1, -p2, -p3, each in [1.0, 2.4] rad/s: it settles whatever is learned.
    Four networks give the poles, initially 1.4 rad/s each, and a_max, initially 0.17 rad/s^2.

    A change that is turned back must end before the road's edge, whatever is learned: a_max is
    never below 0.03 k0 + 0.01 bound, for a loop that saturates longer swings out; and beyond the
    reference lane's centre poles and a_max rise to their upper ends, linearly over 1 m.
    """

    needs = ("speed", "lateral_deviation", "yaw", "yaw_rate", "curvature")
    initial_a_max = 0.17
    slowest_pole, fastest_pole = 1.0, 2.4
    initial_pole = 1.4
    min_speed = 1.0
    linear_angle = 0.03
    recovery_distance = 1.0

    def __init__(
        self, name: str, features: Sequence[str], box: ActionBox, hidden_sizes: Sequence[int]
    ) -> None:
        super().__init__(name, features, box)
        # Networks of a_max and of each pole.
        floor = min(self.limit_floor(torch.tensor(self.initial_pole**3)).item(), 0.9)
        span = self.fastest_pole - self.slowest_pole
        pole = _logit((self.initial_pole - self.slowest_pole) / span)
        initial = (self.initial_limit_logit(floor), pole, pole, pole)
        self.heads = Heads(len(features), hidden_sizes, [[value] for value in initial])

    def limit_floor(self, gain: Tensor) -> Tensor:
        """The least a_max for k0 = `gain`, as a share of the bound."""
        return (A_MAX_FLOOR + self.linear_angle * gain / self.bound).clamp(max=1.0)

    def forward(self, observation: Tensor, normalised: Tensor) -> Tensor:
        """The greedy yaw acceleration, (..., 1) [rad/s^2]."""
        speed, deviation, yaw, yaw_rate, curvature = self.read(observation)
        span = self.fastest_pole - self.slowest_pole
        limit, *logits = self.heads(normalised).split(1, dim=-1)
        beyond = (-deviation / self.recovery_distance).clamp(0.0, 1.0)
        shares = torch.sigmoid(torch.cat(logits, dim=-1))
        shares = shares + beyond * (1.0 - shares)
        p1, p2, p3 = (self.slowest_pole + span * shares).split(1, dim=-1)
        gain = p1 * p2 * p3
        demand = (
            gain * deviation / speed.clamp(min=self.min_speed)
            - (p1 * p2 + p1 * p3 + p2 * p3) * yaw
            - (p1 + p2 + p3) * (yaw_rate - curvature * speed)
        )
        limit = self.limit(limit, self.limit_floor(gain))
        limit = limit + beyond * (self.bound - limit)
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


class CarFollowingMu(Mu):
    """Car following and a bounded correction.

    a = p + tanh(x) (min(p + B, high) - p) where x > 0, p + tanh(x) (p - max(p - B, low)) elsewhere.

    p is the observed car_following_acceleration clipped to [low, high], x a network, about 0
    initially, B = CORRECTION. No correction stops a car that has a free road: car following speeds
    up by more than B before. With p on a bound the correction has no effect, and no gradient,
    toward that side.
    """

    CORRECTION = 1.0
    """B [m/s^2]."""

    needs = ("car_following_acceleration",)

    def __init__(
        self, name: str, features: Sequence[str], box: ActionBox, hidden_sizes: Sequence[int]
    ) -> None:
        super().__init__(name, features)
        self.box = box
        self.correction = Heads(len(features), hidden_sizes, [[0.0]])

    def forward(self, observation: Tensor, normalised: Tensor) -> Tensor:
        """The greedy longitudinal acceleration, (..., 1) [m/s^2]."""
        prior = self.box(*self.read(observation))
        share = torch.tanh(self.correction(normalised))
        # Interpolations, and not the sums of the formula: rounding does not take them out.
        faster = torch.lerp(prior, self.box(prior + self.CORRECTION), share)
        slower = torch.lerp(prior, self.box(prior - self.CORRECTION), -share)
        return torch.where(share > 0, faster, slower)


Structure = Callable[[str, Sequence[str], ActionBox, Sequence[int]], Mu]

LATERAL: dict[str, Structure] = {"paper": PaperMu, "damped": DampedMu}
LONGITUDINAL: dict[str, Structure] = {"idm": CarFollowingMu, "mlp": MLPMu}
STRUCTURES: dict[str, Structure] = {**LATERAL, "mlp": MLPMu}
COMPOSED = tuple(f"{first}+{second}" for first in LATERAL for second in LONGITUDINAL)


class ComposedMu(Mu):
    """a = (lateral(s), longitudinal(s)), two structures with networks and bounds of their own.

    Its name, "LATERAL+LONGITUDINAL", says which; the box has the yaw acceleration first.
    """

    def __init__(
        self, name: str, features: Sequence[str], box: ActionBox, hidden_sizes: Sequence[int]
    ) -> None:
        super().__init__(name, features)
        if box.low.numel() != 2:
            raise ValueError(
                f"mu {name!r} gives two actions, the yaw and the longitudinal acceleration, and "
                f"the box has {box.low.numel()}; allowed: {', '.join(_names_for(box.low.numel()))}"
            )
        lateral, _, longitudinal = name.partition("+")
        self.lateral = LATERAL[lateral](name, features, box.only(0), hidden_sizes)
        self.longitudinal = LONGITUDINAL[longitudinal](name, features, box.only(1), hidden_sizes)
        self.inside_box = self.lateral.inside_box and self.longitudinal.inside_box
        self.needs = self.lateral.needs + self.longitudinal.needs
        self.columns = self.lateral.columns + self.longitudinal.columns

    def forward(self, observation: Tensor, normalised: Tensor) -> Tensor:
        """The greedy yaw and longitudinal acceleration, (..., 2) [rad/s^2, m/s^2]."""
        parts = (self.lateral, self.longitudinal)
        return torch.cat([part(observation, normalised) for part in parts], dim=-1)


def make_mu(name: str, features: Sequence[str], box: ActionBox, hidden_sizes: Sequence[int]) -> Mu:
    """The structure of that name.

    Args:
        name: "paper" or "damped" for one action, "paper+idm", "damped+idm", "paper+mlp" or
            "damped+mlp" for two, "mlp" for any number.
        features: names of the observation's columns.
        box: the admissible actions.
        hidden_sizes: widths of the hidden layers of each of its networks.

    Raises:
        ValueError: the name is unknown, a column is missing, or the box does not fit.
    """
    first, plus, second = name.partition("+")
    if not plus and name in STRUCTURES:
        return STRUCTURES[name](name, features, box, hidden_sizes)
    if plus and first in LATERAL and second in LONGITUDINAL:
        return ComposedMu(name, features, box, hidden_sizes)
    raise ValueError(f"unknown mu {name!r}, allowed: {', '.join((*STRUCTURES, *COMPOSED))}")


def _names_for(actions: int) -> tuple[str, ...]:
    """The names of the structures that give so many actions."""
    return {1: tuple(STRUCTURES), 2: (*COMPOSED, "mlp")}.get(actions, ("mlp",))


def _logit(share: float) -> float:
    return log(share / (1 - share))


def _inverse_softplus(value: float) -> float:
    return log(expm1(value))
