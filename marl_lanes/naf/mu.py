"""The greedy action mu(s) of the quadratic Q-function: its structures by name.

Every mu maps the raw observation (used by its formula) and the normalized observation (used by its
networks) to an action inside the box. In the maneuver frame the lateral deviation is reference
minus position, positive at the start. Yaw and yaw rate are positive toward the target, so
d(deviation)/dt = -speed sin(yaw). The first action is the yaw acceleration [rad/s^2], the second
one, if there is one, the longitudinal acceleration [m/s^2].
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from marl_lanes.naf.lateral import CascadeMu, DampedMu, GatedCascadeMu, PaperMu, SmoothCascadeMu
from marl_lanes.naf.layers import ActionBox, Heads
from marl_lanes.naf.structure import Mu


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
    initially, B = CORRECTION. No correction can stop a vehicle on a free road, because car
    following accelerates by more than B at low speed. If p is at a bound, the correction toward
    that side has no effect and no gradient.
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
        # Interpolation instead of the sums of the formula: rounding cannot leave the bounds.
        faster = torch.lerp(prior, self.box(prior + self.CORRECTION), share)
        slower = torch.lerp(prior, self.box(prior - self.CORRECTION), -share)
        return torch.where(share > 0, faster, slower)


Make = Callable[[str, Sequence[str], ActionBox, Sequence[int]], Mu]
"""Name, features, box and hidden sizes to a structure."""

LATERAL: dict[str, Make] = {
    "cascade": CascadeMu,
    "cascade-smooth": SmoothCascadeMu,
    "cascade-gated": GatedCascadeMu,
    "paper": PaperMu,
    "damped": DampedMu,
}
LONGITUDINAL: dict[str, Make] = {"idm": CarFollowingMu, "mlp": MLPMu}


class ComposedMu(Mu):
    """a = (lateral(s), longitudinal(s)), two structures, each with its own networks and bounds.

    Its name "LATERAL+LONGITUDINAL" names both; the box has the yaw acceleration first.
    """

    def __init__(
        self, name: str, features: Sequence[str], box: ActionBox, hidden_sizes: Sequence[int]
    ) -> None:
        super().__init__(name, features)
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

    def act(self, observation: Tensor, normalised: Tensor) -> tuple[Tensor, Tensor]:
        """The greedy accelerations, and the slopes of the cost of each, (..., 2) each."""
        parts = (self.lateral, self.longitudinal)
        mu, slope = zip(*(part.act(observation, normalised) for part in parts), strict=True)
        return torch.cat(mu, dim=-1), torch.cat(slope, dim=-1)


class Structure(NamedTuple):
    """A row of STRUCTURES."""

    num_actions: int | None
    """How many actions it gives, None for any number."""
    make: Make


STRUCTURES = {
    **{name: Structure(1, make) for name, make in LATERAL.items()},
    **{f"{a}+{b}": Structure(2, ComposedMu) for a in LATERAL for b in LONGITUDINAL},
    "mlp": Structure(None, MLPMu),
}

_COUNTS = {
    1: "one action, the yaw acceleration,",
    2: "two actions, the yaw and the longitudinal acceleration,",
}


def make_mu(name: str, features: Sequence[str], box: ActionBox, hidden_sizes: Sequence[int]) -> Mu:
    """The structure of that name.

    Args:
        name: "cascade", "cascade-smooth", "cascade-gated", "paper" or "damped" for one action,
            each with "+idm" or "+mlp" for two, "mlp" for any number.
        features: names of the observation's columns.
        box: the admissible actions.
        hidden_sizes: widths of the hidden layers of each of its networks.

    Raises:
        ValueError: the name is unknown, a column is missing, or the box does not fit.
    """
    structure = STRUCTURES.get(name)
    if structure is None:
        raise ValueError(f"unknown mu {name!r}, allowed: {', '.join(STRUCTURES)}")
    number = box.low.numel()
    if structure.num_actions not in (None, number):
        fitting = [key for key, one in STRUCTURES.items() if one.num_actions in (None, number)]
        raise ValueError(
            f"mu {name!r} gives {_COUNTS[structure.num_actions]} and the box has {number}; "
            f"allowed: {', '.join(fitting)}"
        )
    return structure.make(name, features, box, hidden_sizes)
