"""Policies without learning, for comparison."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from marl_lanes.evaluation.rollout import Policy
from marl_lanes.scenario import Scenario, ScenarioError

_LANE_KEEPING_FEATURES = ("speed", "lateral_deviation", "yaw", "yaw_rate", "curvature")


def make_random_policy(scenario: Scenario, seed: int) -> Policy:
    """Yaw accelerations drawn uniformly from the action's bounds."""
    bound = scenario.action.max_yaw_acceleration
    generator = np.random.default_rng(seed)

    def act(observations: NDArray[np.float32]) -> NDArray[np.float64]:
        return generator.uniform(-bound, bound, (len(observations), 1))

    return act


def make_lane_keeping_policy(scenario: Scenario) -> Policy:
    """Never change lanes: p^3 e/v - 3 p^2 psi - 3 p (omega - c v), e to the nearest lane's centre.

    Raises:
        ScenarioError: a feature that it needs is not observed.
    """
    columns = _columns(scenario, _LANE_KEEPING_FEATURES)
    bound = scenario.action.max_yaw_acceleration
    pole = scenario.lane_keeping.pole
    width = scenario.road.lane_width

    def act(observations: NDArray[np.float32]) -> NDArray[np.float64]:
        speed, deviation, yaw, yaw_rate, curvature = observations[:, columns].astype(np.float64).T
        error = deviation - width * np.round(deviation / width)
        steering = (
            pole**3 * error / np.maximum(speed, 1.0)
            - 3.0 * pole**2 * yaw
            - 3.0 * pole * (yaw_rate - curvature * speed)
        )
        return np.asarray(np.clip(steering, -bound, bound)[:, None])

    return act


def _columns(scenario: Scenario, needed: Sequence[str]) -> list[int]:
    features: list[str] = list(scenario.observation.features)
    missing = [name for name in needed if name not in features]
    if missing:
        raise ScenarioError(
            f"scenario {scenario.name!r}: observation.features = {features} must hold {missing} "
            "for the lane-keeping policy"
        )
    return [features.index(name) for name in needed]
