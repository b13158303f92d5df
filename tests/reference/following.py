"""The law between two vehicles, and the speed in curves."""

import math

from reference.geometry import Geometry

CONTACT_GAP = 0.01


class Following(Geometry):
    """Car following of one vehicle behind another."""

    def in_curves(self, car, b):
        """The acceleration toward the curve's speed."""
        a_lat = self.scenario.drivers.profiles[car.profile].comfortable_lateral_acceleration
        b = min(b, self.scenario.vehicle.max_braking)
        allowed = self.curve_speed(car.position, car.lateral_position, car.speed, a_lat, b)
        return (allowed - car.speed) / 0.5

    def follow(self, car, front, profile, *, v0, a_m, headway, scale_a_m):
        """The scenario's law toward one leader, or none: Eq. 9, the standard IDM, the ACC model."""
        law = self.scenario.drivers.car_following
        free = (car.speed / v0) ** profile.exponent
        term = 0.0
        if front is not None:
            term = self.interaction(car, front, profile, headway, scale_a_m)
        if law == "max":
            return a_m * (1.0 - max(free, term))
        wanted = a_m * (1.0 - (free + term))
        if law == "acc" and front is not None:
            wanted = self.cool(wanted, self.heuristic(car, front, a_m), profile)
            return min(wanted, a_m * (1.0 - free))
        return wanted

    def heuristic(self, car, front, a_m):
        """The constant-acceleration heuristic of Kesting, Treiber, Helbing 2010."""
        v, v_l, a_l = car.speed, front.speed, min(front.acceleration, a_m)
        gap = max(self.gap(car, front), CONTACT_GAP)
        space = v_l**2 - 2.0 * gap * a_l
        if space > 0.0 and v_l * (v - v_l) <= -2.0 * gap * a_l:
            return v**2 * a_l / space
        return a_l - (v - v_l) ** 2 / (2.0 * gap) * (v > v_l)

    def cool(self, wanted, heuristic, profile):
        b, c = profile.comfortable_braking, self.scenario.drivers.coolness
        if wanted >= heuristic:
            return wanted
        return (1 - c) * wanted + c * (heuristic + b * math.tanh((wanted - heuristic) / b))

    def interaction(self, car, front, profile, headway, a_m):
        root = 2.0 * math.sqrt(a_m * profile.comfortable_braking)
        dynamic = car.speed * headway + car.speed * (car.speed - front.speed) / root
        desired = profile.minimum_gap + max(0.0, dynamic)
        return (desired / max(self.gap(car, front), CONTACT_GAP)) ** 2

    def needed(self, driver, speed, closing, v0):
        """The gap that the rule requires of a rear driver; inf if no gap is enough."""
        rule, profile = self.scenario.gap, self.scenario.drivers.profiles[driver.profile]
        if rule.rule == "kinematic":
            way = max(0.0, closing) ** 2 / (2.0 * rule.max_braking)
            return rule.minimum_gap + rule.time_gap * speed + way
        a_m, free = profile.max_acceleration, (speed / v0) ** profile.exponent
        # a_m (1 - free - (s*/s)^2) = -(b_safe - margin), or without free where that is smaller.
        share = 1.0 + (rule.safe_braking - rule.braking_margin) / a_m
        if self.scenario.drivers.car_following != "max":
            share -= free
        elif free > share:
            return math.inf
        if share <= 0.0:
            return math.inf
        root = 2.0 * math.sqrt(a_m * profile.comfortable_braking)
        dynamic = max(0.0, speed * profile.time_headway + speed * closing / root)
        return max((profile.minimum_gap + dynamic) / math.sqrt(share), rule.minimum_gap)
