"""The structures of mu for one action, the yaw acceleration [rad/s^2].

In the maneuver frame the lateral deviation is reference minus position, positive at the start. Yaw
and yaw rate are positive toward the target, so d(deviation)/dt = -speed sin(yaw).
"""

from collections.abc import Sequence
from math import expm1, log
from typing import Generic, NamedTuple, TypeVar

import torch
from torch import Tensor
from torch.nn.functional import softplus

from marl_lanes.naf.layers import ActionBox, Heads
from marl_lanes.naf.structure import Mu

# a_max is at least this share of the action bound, because it is a divisor.
A_MAX_FLOOR = 0.01

LEAST_THRESHOLD = 1e-6
"""[rad/s^2] Added to the threshold when it is a divisor."""


class _YawAcceleration(Mu):
    """A formula for the yaw acceleration, with a learned limit a_max; the bounds include zero."""

    initial_a_max: float

    def __init__(self, name: str, features: Sequence[str], box: ActionBox) -> None:
        super().__init__(name, features)
        self.bound = min(-box.low.item(), box.high.item())
        if self.bound <= 0:
            raise ValueError(
                f"mu {name!r} needs bounds of the yaw acceleration with zero inside, got "
                f"[{box.low.item():g}, {box.high.item():g}]"
            )

    def initial_limit_logit(self, floor: float = A_MAX_FLOOR) -> float:
        """The logit that `limit` maps to the initial a_max."""
        share = min(self.initial_a_max / self.bound, 0.9)
        return _logit(max((share - floor) / (1 - floor), A_MAX_FLOOR))

    def limit(self, logit: Tensor, floor: Tensor | float = A_MAX_FLOOR) -> Tensor:
        """a_max between a share of the bound and the bound [rad/s^2]."""
        return self.bound * (floor + (1 - floor) * torch.sigmoid(logit))


class PaperMu(_YawAcceleration):
    """a = a_max tanh(beta (deviation / T^2 - speed yaw / T)).

    Three networks give a_max, the sensitivity beta > 0 [s^2/m] and the transition time
    T > 1.5 s, initially 0.25 rad/s^2, 0.31 and 3.4 s. It has no yaw-rate term: it steers a vehicle
    into the target lane, but with constant gains the vehicle cannot settle there.

    Source: Eq. 6 and Eq. 7; the sign of the yaw term follows the module's frame.
    """

    needs = ("speed", "lateral_deviation", "yaw")
    initial_a_max = 0.25
    initial_sensitivity = 0.31
    """beta [s^2/m]."""
    initial_time = 3.4
    """T [s]."""
    min_time = 1.5

    def __init__(
        self, name: str, features: Sequence[str], box: ActionBox, hidden_sizes: Sequence[int]
    ) -> None:
        super().__init__(name, features, box)
        initial = (
            self.initial_limit_logit(),
            _inverse_softplus(self.initial_sensitivity),
            _inverse_softplus(self.initial_time - self.min_time),
        )
        # Three networks, for a_max, beta and T, with one output each.
        self.heads = Heads(len(features), hidden_sizes, [[value] for value in initial])

    def forward(self, observation: Tensor, normalised: Tensor) -> Tensor:
        """The greedy yaw acceleration, (..., 1) [rad/s^2]."""
        speed, deviation, yaw = self.read(observation)
        limit, beta, time = self.heads(normalised).split(1, dim=-1)
        beta = softplus(beta)
        time = self.min_time + softplus(time)
        # Divided by T twice, so that the square of a large T does not overflow.
        demand = (deviation / time - speed * yaw) / time
        return self.limit(limit) * torch.tanh(beta * demand)


class DampedMu(_YawAcceleration):
    """a = a_max tanh(u / a_max), u = k0 deviation / speed - k1 yaw - k2 relative_yaw_rate.

    relative_yaw_rate is yaw_rate - curvature speed; as a divisor, speed is 1 m/s or more. The
    gains k0 = p1 p2 p3, k1 = p1 p2 + p1 p3 + p2 p3, k2 = p1 + p2 + p3 place the poles of the
    linear loop at -p1, -p2, -p3, each in [1.0, 2.4] rad/s, so the loop settles for all parameters.
    Four networks give the poles, initially 1.4 rad/s each, and a_max, initially 0.17 rad/s^2.

    With all parameters an aborted change must end before the road's edge. So a_max is at least
    0.03 k0 + 0.01 bound, because a loop that saturates longer overshoots. Beyond the reference
    lane's centre the poles and a_max rise to their upper bounds, linearly over 1 m.
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
        # Four networks, for a_max and each pole.
        gain = torch.tensor(self.initial_pole**3, dtype=torch.float32)
        floor = min(self.limit_floor(gain).item(), 0.9)
        span = self.fastest_pole - self.slowest_pole
        pole = _logit((self.initial_pole - self.slowest_pole) / span)
        initial = (self.initial_limit_logit(floor), pole, pole, pole)
        self.heads = Heads(len(features), hidden_sizes, [[value] for value in initial])

    def limit_floor(self, gain: Tensor) -> Tensor:
        """The smallest a_max for k0 = `gain`, as a share of the bound."""
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


Gain = TypeVar("Gain", float, Tensor)


class CascadeGains(NamedTuple, Generic[Gain]):
    """The gains of the cascade: numbers, or tensors (..., 1)."""

    limit: Gain
    """a_max, the largest yaw acceleration [rad/s^2]."""
    time: Gain
    """T, time constant of the outer loop [s]."""
    lateral_limit: Gain
    """a_top, the largest lateral acceleration of the outer loop [m/s^2]."""
    lag: Gain
    """tau, time constant of the inner loop [s]."""
    damping: Gain
    """zeta, damping of the outer loop [1]."""
    threshold: Gain
    """Below this yaw acceleration the output is exactly 0 [rad/s^2]."""


TUNED_CASCADE = CascadeGains(
    limit=0.5, time=1.38, lateral_limit=0.58, lag=0.10, damping=0.775, threshold=0.031
)
"""Found by a cross-entropy search; agents/cascade/tune.py starts its search from them."""


def steer_by_cascade(
    speed: Tensor,
    deviation: Tensor,
    yaw: Tensor,
    relative_yaw_rate: Tensor,
    gains: CascadeGains[Gain],
) -> tuple[Tensor, Tensor]:
    """a_max tanh(S((w_ref - w) / tau) / a_max), w_ref = (a_top / v) tanh(a_tmp / a_top).

    a_tmp = deviation / T^2 - 2 zeta v yaw / T follows Eq. 7 and is used as what its unit says, a
    lateral acceleration. The inner loop controls the yaw rate w_ref that produces it. The soft
    threshold S(x) = sign(x) max(|x| - threshold, 0) is exactly 0 where an action gains little,
    because the cost |a| has a kink at 0.

    Args:
        speed: v, (..., 1) [m/s]; a lower speed than 1 m/s counts as 1 m/s.
        deviation: reference minus position, (..., 1) [m].
        yaw: relative to the road, (..., 1) [rad].
        relative_yaw_rate: w, yaw rate minus the road's turning, (..., 1) [rad/s].
        gains: numbers, or (..., 1) each.

    Returns:
        yaw acceleration, (..., 1), within a_max [rad/s^2]; and the input of S as a share of the
        threshold, (..., 1), clipped to [-1, 1].
    """
    return _turn(_outer_loop(speed, deviation, yaw, gains), relative_yaw_rate, gains)


def _outer_loop(speed: Tensor, deviation: Tensor, yaw: Tensor, gains: CascadeGains[Gain]) -> Tensor:
    """w_ref, the yaw rate that leads to the centre, (..., 1) [rad/s]."""
    speed = speed.clamp(min=1.0)
    # Divided by T twice, so that the square of a large T does not overflow.
    wanted = (deviation / gains.time - 2.0 * gains.damping * speed * yaw) / gains.time
    return gains.lateral_limit * torch.tanh(wanted / gains.lateral_limit) / speed


def _turn(
    reference: Tensor, relative_yaw_rate: Tensor, gains: CascadeGains[Gain]
) -> tuple[Tensor, Tensor]:
    """The yaw acceleration toward w_ref [rad/s^2], and the input of S as a share, (..., 1) each."""
    demand = (reference - relative_yaw_rate) / gains.lag
    beyond = torch.sign(demand) * torch.relu(demand.abs() - gains.threshold)
    share = (demand / (gains.threshold + LEAST_THRESHOLD)).clamp(-1.0, 1.0)
    return gains.limit * torch.tanh(beyond / gains.limit), share


class CascadeMu(_YawAcceleration):
    """`steer_by_cascade` with gains from six networks, initially TUNED_CASCADE, a_max 0.9 bound.

    Each gain stays in its range. With all parameters the vehicle ends within 0.3 m of the centre,
    and a vehicle that aborts at the marking stays on the road. Before it settles it may overshoot
    the centre by up to 2.2 m; in an outer lane this is over the road's edge. The lag is shorter
    than 2 zeta T, above which the linear loop is unstable. a_top is at most 1 m/s^2, the limit of
    UN R79. The threshold suppresses at most the yaw rate for 0.2 m of deviation, and at most 0.3
    of the largest yaw rate.
    """

    needs = ("speed", "lateral_deviation", "yaw", "yaw_rate", "curvature")
    initial_a_max = TUNED_CASCADE.limit
    limit_floor = 0.4
    times = (1.0, 2.5)
    lateral_limits = (0.3, 1.0)
    lags = (0.08, 0.25)
    dampings = (0.5, 1.4)
    max_threshold = 0.05
    max_held_back = 0.2
    """[m]"""
    max_share_held_back = 0.3
    has_threshold = True

    def __init__(
        self, name: str, features: Sequence[str], box: ActionBox, hidden_sizes: Sequence[int]
    ) -> None:
        super().__init__(name, features, box)
        tuned = TUNED_CASCADE
        initial = (
            self.initial_limit_logit(self.limit_floor),
            _range_logit(tuned.time, *self.times),
            _range_logit(tuned.lateral_limit, *self.lateral_limits),
            _range_logit(tuned.lag, *self.lags),
            _range_logit(tuned.damping, *self.dampings),
            _range_logit(tuned.threshold, 0.0, self.max_threshold),
        )
        self.heads = Heads(len(features), hidden_sizes, [[value] for value in initial])

    def gains(self, speed: Tensor, normalised: Tensor) -> CascadeGains[Tensor]:
        """The gains in a state, (..., 1) each."""
        limit, *logits = self.heads(normalised).split(1, dim=-1)
        shares = torch.sigmoid(torch.cat(logits, dim=-1))
        time, lateral_limit, lag, damping, threshold = shares.split(1, dim=-1)
        lateral_limit = _in_range(lateral_limit, *self.lateral_limits)
        lag = _in_range(lag, *self.lags)
        time = _in_range(time, *self.times)
        held_back = torch.minimum(
            self.max_held_back / time.square(), self.max_share_held_back * lateral_limit
        )
        highest = self.has_threshold * held_back / (speed.clamp(min=1.0) * lag)
        return CascadeGains(
            limit=self.limit(limit, self.limit_floor),
            time=time,
            lateral_limit=lateral_limit,
            lag=lag,
            damping=_in_range(damping, *self.dampings),
            threshold=torch.minimum(self.max_threshold * threshold, highest),
        )

    def forward(self, observation: Tensor, normalised: Tensor) -> Tensor:
        """The greedy yaw acceleration, (..., 1) [rad/s^2]."""
        return self.act(observation, normalised)[0]

    def act(self, observation: Tensor, normalised: Tensor) -> tuple[Tensor, Tensor]:
        """The greedy yaw acceleration [rad/s^2], and the slope of the cost |a| at it."""
        speed, deviation, yaw, yaw_rate, curvature = self.read(observation)
        gains = self.gains(speed, normalised)
        return steer_by_cascade(speed, deviation, yaw, yaw_rate - curvature * speed, gains)


class SmoothCascadeMu(CascadeMu):
    """The cascade without its soft threshold, for comparison: it always steers a little."""

    has_threshold = False


class GatedCascadeMu(CascadeMu):
    """The cascade and straight on, mixed with a share g from one more network, initially 0.98.

    w_ref = g w_ref(deviation) + (1 - g) w_ref(0). With the share 0 the vehicle goes straight on,
    within the threshold. So a policy can wait in its lane where it foresees that a change would be
    aborted. The share is outside of the tanh in w_ref: inside, where this is saturated, it would
    have no gradient, and no gate would learn to close.

    A change has begun below BEGINS_AT and wholly below ALL_BEGUN_AT, linearly between: from there
    on the share is 1, and the gains see the own motion alone (`needs`). So whatever is learned, a
    change that has begun arrives, and what others do, however strange, does not change how it
    steers.
    """

    BEGINS_AT, ALL_BEGUN_AT = 3.6, 3.3
    """[m] Deviations. In narrower lanes than that it is the cascade. In lanes wider than 5.4 m
    (4.6 m for trucks) a body is over the marking before, and may be held there."""
    initial_share = 0.98
    others: Tensor
    sharpness = 5.0
    """Of the gate, because half a turn is dearer than a change or none."""

    def __init__(
        self, name: str, features: Sequence[str], box: ActionBox, hidden_sizes: Sequence[int]
    ) -> None:
        super().__init__(name, features, box, hidden_sizes)
        logit = _logit(self.initial_share) / self.sharpness
        self.gate = Heads(len(features), hidden_sizes, [[logit]])
        others = [float(feature not in self.needs) for feature in features]
        self.register_buffer("others", torch.tensor(others), persistent=False)

    def act(self, observation: Tensor, normalised: Tensor) -> tuple[Tensor, Tensor]:
        """The greedy yaw acceleration [rad/s^2], and the slope of the cost |a| at it."""
        speed, deviation, yaw, yaw_rate, curvature = self.read(observation)
        begun = (self.BEGINS_AT - deviation) / (self.BEGINS_AT - self.ALL_BEGUN_AT)
        begun = begun.clamp(0.0, 1.0)
        share = torch.sigmoid(self.sharpness * self.gate(normalised))
        share = torch.lerp(share, torch.ones_like(share), begun)
        gains = self.gains(speed, normalised * (1.0 - begun * self.others))
        straight = _outer_loop(speed, torch.zeros_like(deviation), yaw, gains)
        across = _outer_loop(speed, deviation, yaw, gains)
        reference = torch.lerp(straight, across, share)
        return _turn(reference, yaw_rate - curvature * speed, gains)


def _logit(share: float) -> float:
    return log(share / (1 - share))


def _inverse_softplus(value: float) -> float:
    return log(expm1(value))


def _range_logit(value: float, low: float, high: float) -> float:
    return _logit((value - low) / (high - low))


def _in_range(share: Tensor, low: float, high: float) -> Tensor:
    return low + share * (high - low)
