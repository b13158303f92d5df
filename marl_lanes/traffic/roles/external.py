"""Followers that a policy drives: the protocol, two examples, the registry, the checks."""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from marl_lanes.scenario import Scenario, ScenarioError
from marl_lanes.scenario.dispositions import LEARNED, SCRIPTED
from marl_lanes.scenario.messages import shown
from marl_lanes.traffic.arguments import check_functions, read_numbers
from marl_lanes.traffic.roles.follower import FOLLOWER

FOLLOWER_COLUMNS = {feature.name: column for column, feature in enumerate(FOLLOWER.features)}
"""Column of each feature in a follower's observation."""


class FollowerPolicy(Protocol):
    """A policy of external followers: a function of the observations of n followers.

    It is called once per time step for all paired drivers with its name on all roads, in the order
    of road and slot. It must not keep the array. For equal observations it must return equal
    accelerations (no random numbers of its own); otherwise runs are not repeatable.
    """

    def __call__(self, observations: NDArray[np.float32], /) -> NDArray[np.floating]:
        """Accelerations (n,) [m/s^2] for observations (n, G), columns as FOLLOWER_COLUMNS."""


class FollowerError(ValueError):
    """A follower's policy returned invalid accelerations."""


def check_brakes(observations: NDArray[np.float32], /) -> NDArray[np.floating]:
    """Speed up into the gap that the changer has accepted, brake hard where it gets short.

    a = -3 m/s^2 where gap < 8 m + 0.5 s max(0, -dv), otherwise 2 m/s^2; dv is the changer's speed
    minus its own.

    Args:
        observations: (n, G).

    Returns:
        accelerations, (n,) [m/s^2].
    """
    gap = observations[:, FOLLOWER_COLUMNS["gap"]]
    closing = -observations[:, FOLLOWER_COLUMNS["relative_speed"]]
    is_near = gap < 8.0 + 0.5 * np.maximum(closing, 0.0)
    return np.where(is_near, -3.0, 2.0)


def yield_late(observations: NDArray[np.float32], /) -> NDArray[np.floating]:
    """Close up to the changer until its body is at the marking, then let it in.

    a = clip(0.3/s^2 (gap - g) + 0.8/s dv, -3, 2) m/s^2, the constant-gap law of adaptive cruise
    control. The wanted gap g is 5 m while the changer's centre is more than 2.8 m from that of the
    target lane, and 2 m + 1.5 s v from then on. Half a lane of 3.75 m and half a car are 2.8 m.

    Args:
        observations: (n, G).

    Returns:
        accelerations, (n,) [m/s^2].
    """
    speed, gap, relative_speed, deviation = (
        observations[:, FOLLOWER_COLUMNS[name]]
        for name in ("speed", "gap", "relative_speed", "changer_lateral_deviation")
    )
    wanted = np.where(deviation > 2.8, 5.0, 2.0 + 1.5 * speed)
    return np.clip(0.3 * (gap - wanted) + 0.8 * relative_speed, -3.0, 2.0)


_registered: dict[str, FollowerPolicy] = {
    "brake-checker": check_brakes,
    "late-yielder": yield_late,
}


def register_follower(name: str, policy: FollowerPolicy) -> None:
    """Register a policy as a disposition, with this name in ``followers.mix``.

    Args:
        name: letters, digits, _ and -, a letter or _ first. A second policy with this name
            replaces the first.
        policy: see ``FollowerPolicy``.

    Raises:
        ValueError: the name is a scripted disposition or ``learned``, or has another form.
        TypeError: the policy cannot be called.
    """
    taken = (*SCRIPTED, LEARNED)
    is_name = isinstance(name, str) and name.isascii() and name.replace("-", "_").isidentifier()
    if not is_name or name in taken:
        raise ValueError(
            f"follower name {shown(name)}: must be letters, digits, _ and -, and none of {taken}"
        )
    if not callable(policy):
        raise TypeError(f"follower {name!r}: its policy must be callable, got {shown(policy)}")
    _registered[name] = policy


def choose_policies(
    scenario: Scenario,
    given: Mapping[str, FollowerPolicy] | None,
    *,
    has_learner: bool,
) -> tuple[FollowerPolicy | None, ...]:
    """The policy of every external name in the mix, in order; None if a learner acts.

    Raises:
        ScenarioError: a name has no policy.
        ValueError: ``given`` is no mapping of names to functions.
    """
    check_functions("follower_policies", given)
    chosen: list[FollowerPolicy | None] = []
    for name in scenario.followers.external_names:
        policy = (given or {}).get(name, _registered.get(name))
        if name == LEARNED and has_learner:
            policy = None
        elif policy is None:
            learned = "learned (with followers.learned.checkpoint or learned_followers=True)"
            raise ScenarioError(
                f"scenario {scenario.name!r}: followers.mix: {name!r} has no policy; allowed: "
                f"{', '.join([*SCRIPTED, learned, *sorted(_registered)])}, or a name given to "
                "register_follower or in follower_policies"
            )
        chosen.append(policy)
    return tuple(chosen)


def ask_policies(
    policies: Sequence[FollowerPolicy | None],
    drivers: NDArray[np.integer[Any]],
    observations: NDArray[np.float32],
    scenario: Scenario,
) -> list[tuple[NDArray[np.bool_], NDArray[np.float64]]]:
    """The answers of all policies: whom each drives, (E, A) bool, and their accelerations.

    Args:
        policies: of the external dispositions, in order; None where a learner acts.
        drivers: (E, A) ``policy`` of FOLLOWER.
        observations: (E, A, G).
        scenario: for its names and bounds.

    Raises:
        FollowerError: one returned invalid accelerations.
    """
    answers = []
    for code, policy in enumerate(policies):
        rows = drivers == code
        if policy is not None and rows.any():
            name = scenario.followers.external_names[code]
            answers.append((rows, ask_policy(name, policy, observations[rows], scenario)))
    return answers


def ask_policy(
    name: str, policy: FollowerPolicy, observations: NDArray[np.float32], scenario: Scenario
) -> NDArray[np.float64]:
    """The policy's accelerations, checked, (n,) float64 [m/s^2].

    Raises:
        FollowerError: wrong shape or type, not finite, or out of the bounds of followers.external.
    """
    returned = policy(observations.copy())
    try:
        given = read_numbers("returned", returned, (len(observations),))
    except ValueError as error:
        raise FollowerError(f"follower {name!r}: {error}") from None
    accelerations = given.astype(np.float64, copy=False)
    (acceleration,) = FOLLOWER.act(scenario)
    low, high = acceleration.low, acceleration.high
    # The bounded output of a float32 network may exceed its bounds by rounding.
    margin = 1e-5
    bad = ~((low - margin <= accelerations) & (accelerations <= high + margin))
    if bad.any():
        row = int(np.argmax(bad))
        raise FollowerError(
            f"follower {name!r}: returned {accelerations[row]} for row {row}, must be a finite "
            f"acceleration between {low} and {high} m/s^2 (followers.external); it saw "
            f"{dict(zip(FOLLOWER_COLUMNS, observations[row].tolist(), strict=True))}"
        )
    return accelerations
