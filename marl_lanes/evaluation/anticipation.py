"""What a lane changer can foresee: whether the follower in the target lane will be too near."""

from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from marl_lanes.scenario import Scenario

FOLLOWER_ACCELERATION = 2.0
"""[m/s^2] Of a follower that closes the gap; less than the shipped adversary's largest, 3 m/s^2,
because its own leader and its speed hold it back."""

REACTION = 0.1
"""[s] Beyond the time of the way to the marking: steering does not act at once."""

BEGUN = 0.15
"""[m] Off its lane's centre a change has begun, and goes on."""

Column = NDArray[np.float64]
"""(N,), one value per agent."""


@dataclass(frozen=True)
class Anticipation:
    """Whether a change that begins now would be aborted: the follower comes too near too soon.

    t is the time in which the body is over the marking with the largest lateral acceleration from
    the present lateral speed. By then the gap is s - dv t + (a - a_f) t^2/2, with the accelerations
    a of the changer and a_f of the follower, and the gap rule wants s*/sqrt(1 + b_safe/a_m), where
    Eq. 9 brakes with b_safe; s* is that of the driver profile with the largest share, because
    nobody sees which one drives behind. The body is the scenario's vehicle, also of a profile with
    another size.

    Args:
        scenario: its road, vehicles, drivers and gap rule.
        lateral_limit: largest lateral acceleration on the way to the marking [m/s^2].
        follower_acceleration: a_f [m/s^2].
    """

    scenario: Scenario
    lateral_limit: float
    follower_acceleration: float = FOLLOWER_ACCELERATION

    def foresees_abort(
        self,
        speed: Column,
        deviation: Column,
        yaw: Column,
        acceleration: Column,
        gap: Column,
        relative_speed: Column,
    ) -> NDArray[np.bool_]:
        """Whether the gap will be too small; false for a change that has begun.

        Args:
            speed: of the changer, (N,) [m/s].
            deviation: to the target lane's centre, (N,) [m].
            yaw: relative to the road, (N,) [rad].
            acceleration: of the changer from now on, (N,) [m/s^2].
            gap: to the follower in the target lane, bumper to bumper, (N,) [m].
            relative_speed: the follower's speed minus the changer's, (N,) [m/s].

        Returns:
            (N,).
        """
        time = self.time_to_marking(deviation, speed * np.sin(yaw))
        closing = relative_speed + (self.follower_acceleration - acceleration) * time
        left = gap - (relative_speed + closing) / 2.0 * time
        behind = speed + relative_speed + self.follower_acceleration * time
        has_begun = deviation <= self.scenario.road.lane_width - BEGUN
        return np.asarray(~has_begun & (left < self.needed_gap(behind, closing)))

    def time_to_marking(self, deviation: Column, lateral_speed: Column) -> Column:
        """Until the body is over the marking, (N,) [s]."""
        width = self.scenario.road.lane_width + self.scenario.vehicle.width
        way = np.maximum(deviation - width / 2.0, 0.0)
        limit = self.lateral_limit
        root = np.sqrt(np.maximum(lateral_speed, 0.0) ** 2 + 2.0 * limit * way)
        return np.asarray((root - lateral_speed) / limit + REACTION)

    def needed_gap(self, speed: Column, closing: Column) -> Column:
        """The smallest gap that the rule allows behind the changer, (N,) [m].

        Args:
            speed: of the follower, (N,) [m/s].
            closing: its speed minus the changer's, (N,) [m/s].
        """
        rule = self.scenario.gap
        if rule.rule == "kinematic":
            braking = np.maximum(closing, 0.0) ** 2 / (2.0 * rule.max_braking)
            return np.asarray(rule.minimum_gap + rule.time_gap * speed + braking)
        mix = self.scenario.drivers.mix
        profile = self.scenario.drivers.profiles[max(mix, key=mix.__getitem__)]
        scale = 2.0 * sqrt(profile.max_acceleration * profile.comfortable_braking)
        dynamic = speed * (profile.time_headway + closing / scale)
        desired = profile.minimum_gap + np.maximum(dynamic, 0.0)
        share = sqrt(1.0 + rule.safe_braking / profile.max_acceleration)
        return np.maximum(desired / share, rule.minimum_gap)
