"""The acceleration of every driver, and moving over for a changer."""

import math

from reference.following import CONTACT_GAP
from reference.gap_seeking import GapSeeking

from marl_lanes.traffic.machine.state import Disposition, Phase


class Driving(GapSeeking):
    """Accelerations by disposition and action, and moves over."""

    def longitudinal(self, car):
        """The smallest acceleration toward the leaders in the car's lanes, by disposition."""
        profile = self.scenario.drivers.profiles[car.profile]
        style = {"v0": car.desired_speed, "a_m": profile.max_acceleration}
        style |= {"headway": profile.time_headway, "scale_a_m": profile.max_acceleration}
        plain = dict(style)
        is_body_in = car.changer is not None and (
            car.changer.agent.target in self.lanes_of(car.changer)
        )
        is_adversarial = car.disposition == Disposition.ADVERSARIAL
        if car.changer is not None and not is_body_in and is_adversarial:
            hostile = self.scenario.followers.adversarial
            style["v0"] *= hostile.desired_speed_factor
            style["a_m"] = style["scale_a_m"] = hostile.max_acceleration
            style["headway"] = hostile.time_headway
        style["v0"] *= self.hurry(car)
        plain["v0"] *= self.hurry(car)
        leaders = [None]
        for lane in self.lanes_of(car):
            leaders.append(self.ahead(car, lambda other, lane=lane: lane in self.lanes_of(other)))
        wanted = min(self.follow(car, front, profile, **style) for front in leaders)
        wanted = min(wanted, self.seek(car))
        # Toward its own target lane a driver uses its profile, also if it is adversarial.
        beyond = [front for front in self.leaders_beyond(car) if front is not None]
        toward = [self.follow(car, front, profile, **plain) for front in beyond]
        if car.agent is not None and car.agent.phase == Phase.ENGAGED and toward:
            wanted = min(wanted, max(min(toward), self.hold(car)))
        if car.moving_over:
            wanted = min(wanted, *toward, math.inf)
        is_left = car.moving_over and car.changer and car.changer.agent.target != car.lane
        plain["v0"] = car.desired_speed
        is_cooperative = car.disposition == Disposition.COOPERATIVE
        if car.changer is not None and is_cooperative and not is_left:
            gentle = self.scenario.followers.cooperative
            plain["headway"] = gentle.time_headway
            yielding = self.follow(car, car.changer, profile, **plain)
            wanted = min(wanted, yielding if is_body_in else max(yielding, -gentle.max_braking))
        wanted = min(wanted, self.in_curves(car, profile.comfortable_braking))
        return max(wanted, -self.scenario.vehicle.max_braking)

    def drive(self, car, actions, follower_actions):
        """Car following, or an agent's second action or a follower's action instead."""
        following, second = self.longitudinal(car), self.scenario.action.longitudinal
        external = self.scenario.followers.external
        wanted = following
        if car.agent is not None and second is not None:
            car.agent.car_following = self.no_reversing(car, following)
            wanted = self.within(car, actions[car.agent.slot][1], second)
            wanted = min(wanted, self.guard(car, second.max_acceleration))
        for slot, follower in self.followers.items():
            if follower.car is car:
                wanted = self.within(car, follower_actions[slot], external)
                if external.is_guarded:
                    wanted = min(wanted, self.guard(car, external.max_acceleration))
        return max(wanted, -self.scenario.vehicle.max_braking)

    def within(self, car, wanted, limits):
        """The action within its bounds; it does not accelerate a car beyond the speed limit."""
        wanted = min(max(wanted, -limits.max_braking), limits.max_acceleration)
        return min(wanted, max(0.0, (limits.max_speed - car.speed) / self.scenario.time_step))

    def guard(self, car, a_m):
        """a_m (1 - (s*/s)^2), the smallest over the leaders, with the gap rule's numbers."""
        rule, allowed = self.scenario.gap, [a_m]
        fronts = [
            self.ahead(car, lambda other, lane=lane: lane in self.lanes_of(other))
            for lane in self.lanes_of(car)
        ]
        if car.agent is not None and car.agent.phase == Phase.ENGAGED:
            fronts += self.leaders_beyond(car)
        for front in fronts:
            if front is not None:
                dynamic = car.speed * (car.speed - front.speed)
                dynamic /= 2.0 * math.sqrt(a_m * rule.max_braking)
                desired = rule.minimum_gap + max(0.0, rule.time_gap * car.speed + dynamic)
                share = desired / max(self.gap(car, front), CONTACT_GAP)
                allowed.append(a_m * (1.0 - share**2))
        return min(*allowed, self.in_curves(car, rule.max_braking))

    def would_follow(self, agent):
        """Car following of an agent's car in the present state, behind the agent's neighbors."""
        car, around = agent.car, agent.neighbors
        profile = self.scenario.drivers.profiles[car.profile]
        style = {"v0": car.desired_speed * self.hurry(car), "a_m": profile.max_acceleration}
        style |= {"headway": profile.time_headway, "scale_a_m": profile.max_acceleration}
        leader = around["leader"] if agent.origin in self.lanes_of(car) else None
        wanted = min(self.follow(car, front, profile, **style) for front in (None, leader))
        wanted = min(wanted, self.seek(car))
        front = around["target_leader"]
        is_changing = agent.target in self.lanes_of(car) or agent.phase == Phase.ENGAGED
        if front is not None and is_changing:
            toward = self.follow(car, front, profile, **style)
            wanted = min(wanted, max(toward, self.hold(car)))
        wanted = min(wanted, self.in_curves(car, profile.comfortable_braking))
        return self.no_reversing(car, max(wanted, -self.scenario.vehicle.max_braking))

    def no_reversing(self, car, acceleration):
        """At least the acceleration that stops the car within the step."""
        after = max(0.0, car.speed + acceleration * self.scenario.time_step)
        return (after - car.speed) / self.scenario.time_step

    def move_over(self, car):
        """End or take back the car's move, or begin one."""
        if car.moving_over:
            if self.has_settled(car):
                car.moving_over = 0
            elif car.lane not in self.lanes_of(car) and not self.has_room_in(car, car.lane, 0.0):
                car.lane, car.moving_over = car.lane - car.moving_over, 0
                self.counts["num_moves_returned"] += 1
            return
        is_cooperative = car.disposition == Disposition.COOPERATIVE
        if car.changer is None or car.agent is not None or not is_cooperative or car.speed < 5.0:
            return
        asking = car.changer.agent
        beyond = car.lane + asking.direction
        is_wanted = asking.target == car.lane and car.lane not in self.lanes_of(car.changer)
        if not is_wanted or not 0 <= beyond < self.scenario.road.num_lanes:
            return
        profile = self.scenario.drivers.profiles[car.profile]
        style = {"v0": car.desired_speed, "a_m": profile.max_acceleration}
        style |= {"headway": profile.time_headway, "scale_a_m": profile.max_acceleration}
        gentle = self.scenario.followers.cooperative
        patient = style | {"headway": gentle.time_headway}
        braking = self.follow(car, car.changer, profile, **patient)
        freely = self.follow(
            car, self.ahead(car, lambda x: self.is_in(x, beyond)), profile, **style
        )
        is_worth_it = braking < 0.0 and freely > max(braking, -gentle.max_braking)
        if (
            is_worth_it
            and self.has_settled(car)
            and self.has_room_in(car, beyond, self.scenario.gap.braking_margin)
        ):
            car.lane, car.moving_over = beyond, asking.direction
            self.counts["num_moves_over"] += 1

    def has_room_in(self, car, lane, margin):
        ahead, behind = (
            find(car, lambda x: self.is_in(x, lane)) for find in (self.ahead, self.behind)
        )
        braking = self.scenario.gap.safe_braking - margin
        return self.is_gap_safe(car, ahead, braking) and self.is_gap_safe(behind, car, braking)

    def has_settled(self, car):
        """Whether it is inside the lane that it keeps, and the completion criterion holds."""
        is_inside = list(self.lanes_of(car)) == [car.lane]
        return is_inside and self.is_at(car, self.centre(car.lane) - car.lateral_position)
