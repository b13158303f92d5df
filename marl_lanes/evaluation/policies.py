"""Policies without learning, for comparison."""

from collections.abc import Callable, Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from marl_lanes.evaluation.anticipation import Anticipation
from marl_lanes.evaluation.driving import Policy
from marl_lanes.evaluation.mpc import RecedingHorizon
from marl_lanes.evaluation.quintic import steer_by_quintic
from marl_lanes.naf.lateral import TUNED_CASCADE, CascadeGains, steer_by_cascade
from marl_lanes.scenario import Scenario, ScenarioError
from marl_lanes.traffic.machine.state import Phase
from marl_lanes.traffic.roles.changer import CHANGER

_STEERING_FEATURES = ("speed", "lateral_deviation", "yaw", "yaw_rate", "curvature")
_CAR_FOLLOWING = "car_following_acceleration"

LATERAL_LIMIT = 1.0
"""[m/s^2] What UN R79 allows: the body is over the marking sooner than with the tuned constants."""

URGE = 1.0
"""[m/s^2] More than car following, away from who closes the gap behind."""

Column = NDArray[np.float64]
"""(N,), one value per agent."""


def make_random_policy(scenario: Scenario, seed: int) -> Policy:
    """Actions drawn uniformly from their bounds."""
    low, high = _bounds(scenario)
    generator = np.random.default_rng(seed)

    def act(observations: NDArray[np.float32]) -> NDArray[np.float64]:
        return generator.uniform(low, high, (len(observations), low.size))

    return act


def make_lane_keeping_policy(scenario: Scenario) -> Policy:
    """Never change lanes: p^3 e/v - 3 p^2 psi - 3 p (omega - c v), e to the nearest lane's centre.

    A second action, if the scenario has one, is the car-following acceleration.

    Raises:
        ScenarioError: a feature that it needs is not observed.
    """
    pole = scenario.lane_keeping.pole
    width = scenario.road.lane_width

    def steer(speed: Column, deviation: Column, yaw: Column, turning: Column) -> Column:
        error = deviation - width * np.round(deviation / width)
        bend = pole**3 * error / np.maximum(speed, 1.0)
        return np.asarray(bend - 3.0 * pole**2 * yaw - 3.0 * pole * turning)

    return _make_steering_policy(scenario, "lane-keeping", steer)


def make_tuned_cascade_policy(scenario: Scenario) -> Policy:
    """The classical controller to compare learners with: mu cascade with its tuned constants.

    A second action, if the scenario has one, is the car-following acceleration.

    Raises:
        ScenarioError: a feature that it needs is not observed.
    """
    return _make_steering_policy(scenario, "tuned-cascade", _cascade(TUNED_CASCADE))


def make_assertive_cascade_policy(
    scenario: Scenario, *, lateral_limit: float = LATERAL_LIMIT, urge: float = URGE
) -> Policy:
    """The classical controller for drivers behind who close the gap: it hurries.

    The cascade steers with more lateral acceleration, and a second action, if the scenario has one,
    is the car-following acceleration, and more while engaged.

    Args:
        scenario: that it drives on.
        lateral_limit: largest lateral acceleration on the way to the target lane [m/s^2].
        urge: beyond car following while engaged [m/s^2].

    Raises:
        ScenarioError: a feature that it needs is not observed.
    """
    steer = _cascade(TUNED_CASCADE._replace(lateral_limit=lateral_limit))
    return _make_steering_policy(scenario, "assertive-cascade", steer, urge=urge)


def make_anticipating_cascade_policy(
    scenario: Scenario, *, lateral_limit: float = LATERAL_LIMIT, urge: float = URGE
) -> Policy:
    """The assertive cascade, which does not begin where it foresees that it must abort.

    While it is engaged, at its own lane's centre, and the follower in the target lane would be too
    near by the time that the body is over the marking (`Anticipation`), it stays where it is.

    Args:
        scenario: that it drives on.
        lateral_limit: largest lateral acceleration on the way to the target lane [m/s^2].
        urge: beyond car following while engaged [m/s^2].

    Raises:
        ScenarioError: a feature that it needs is not observed.
    """
    cascade = _cascade(TUNED_CASCADE._replace(lateral_limit=lateral_limit))
    anticipation = Anticipation(scenario, lateral_limit)
    chosen = scenario.action.longitudinal

    def steer(
        speed: Column, deviation: Column, yaw: Column, turning: Column, *others: Column
    ) -> Column:
        gap, relative_speed, phase, acceleration = others
        if chosen is not None:
            acceleration = np.clip(
                acceleration + urge, -chosen.max_braking, chosen.max_acceleration
            )
        waits = (phase == Phase.ENGAGED) & anticipation.foresees_abort(
            speed, deviation, yaw, acceleration, gap, relative_speed
        )
        return cascade(speed, np.where(waits, 0.0, deviation), yaw, turning)

    own = "acceleration" if chosen is None else _CAR_FOLLOWING
    more = ("target_follower_gap", "target_follower_relative_speed", "phase", own)
    return _make_steering_policy(scenario, "anticipating-cascade", steer, more, urge=urge)


def make_quintic_policy(scenario: Scenario) -> Policy:
    """A quintic polynomial to the target lane's centre, planned anew at every step.

    A second action, if the scenario has one, is the car-following acceleration.

    Raises:
        ScenarioError: a feature that it needs is not observed.
    """

    def steer(speed: Column, deviation: Column, yaw: Column, turning: Column) -> Column:
        return steer_by_quintic(speed, deviation, yaw, turning, scenario.time_step)

    return _make_steering_policy(scenario, "quintic", steer)


def make_mpc_policy(scenario: Scenario) -> Policy:
    """Model-predictive control: the linear program of the optimum on a receding horizon.

    A second action, if the scenario has one, is the car-following acceleration.

    Raises:
        ScenarioError: a feature that it needs is not observed.
    """
    return _make_steering_policy(
        scenario, "mpc", RecedingHorizon(scenario).steer, ("acceleration",)
    )


def _cascade(gains: CascadeGains[float]) -> Callable[..., Column]:
    """Speed, deviation, yaw, relative yaw rate to the yaw acceleration."""

    def steer(speed: Column, deviation: Column, yaw: Column, turning: Column) -> Column:
        steering, _ = steer_by_cascade(
            torch.from_numpy(speed),
            torch.from_numpy(deviation),
            torch.from_numpy(yaw),
            torch.from_numpy(turning),
            gains,
        )
        return np.asarray(steering.numpy())

    return steer


def _make_steering_policy(
    scenario: Scenario,
    name: str,
    steer: Callable[..., Column],
    more: Sequence[str] = (),
    *,
    urge: float = 0.0,
) -> Policy:
    """A policy that steers by ``steer``, with car following.

    Args:
        scenario: that it drives on.
        name: of the policy, for messages.
        steer: speed, deviation, yaw, yaw rate relative to the road, and the features ``more``,
            (N,) each, to the yaw acceleration (N,).
        more: further features that it needs.
        urge: of a second action, beyond car following while engaged [m/s^2].
    """
    needed = (*_STEERING_FEATURES, *more)
    num_steering = len(needed)
    has_urge = urge > 0.0 and scenario.action.longitudinal is not None
    if scenario.action.longitudinal is not None:
        needed = (*needed, _CAR_FOLLOWING, *(["phase"] if has_urge else []))
    columns = _columns(scenario, needed, name)
    low, high = _bounds(scenario)

    def act(observations: NDArray[np.float32]) -> NDArray[np.float64]:
        seen = observations[:, columns].astype(np.float64)
        # Copies, because torch needs contiguous rows.
        speed, deviation, yaw, yaw_rate, curvature, *others = seen[:, :num_steering].T.copy()
        steering = steer(speed, deviation, yaw, yaw_rate - curvature * speed, *others)
        actions = np.column_stack([steering, seen[:, num_steering : num_steering + low.size - 1]])
        if has_urge:
            actions[:, 1] += urge * (seen[:, -1] == Phase.ENGAGED)
        return np.asarray(np.clip(actions, low, high))

    return act


def _bounds(scenario: Scenario) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The smallest and the largest action, each (D,)."""
    dimensions = CHANGER.act(scenario)
    return np.array([one.low for one in dimensions]), np.array([one.high for one in dimensions])


def _columns(scenario: Scenario, needed: Sequence[str], name: str) -> list[int]:
    features: list[str] = list(scenario.observation.features)
    missing = [name for name in needed if name not in features]
    if missing:
        raise ScenarioError(
            f"scenario {scenario.name!r}: observation.features = {features} must contain {missing} "
            f"for the policy {name}"
        )
    return [features.index(name) for name in needed]
