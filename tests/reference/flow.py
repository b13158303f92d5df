"""Vehicles that enter, collide and leave."""

import math

from reference.command import Commands
from reference.geometry import hull, overlap_area
from reference.records import SCRIPTED, Car

from marl_lanes.traffic.machine.state import CollisionKind, Disposition


class Flow(Commands):
    """Departures, collisions and removal."""

    def is_hit_by(self, car, other):
        """Whether two bodies overlap, whether they moved far, whether they only met on the way.

        Seen from the other one, a body covers the hull of itself at both ends of its way.
        """
        covered, sizes = self.corners(car), (self.size(car), self.size(other))
        back, aside = ((b - a) - (d - c) for a, b, c, d in zip(
            car.before, (car.position, car.lateral_position),
            other.before, (other.position, other.lateral_position), strict=True))  # fmt: skip
        length, width = (sum(size) / 2 for size in zip(*sizes, strict=True))
        is_far = abs(back) > length or abs(aside) > width / 2
        ahead = car.position - other.position
        if min(ahead, ahead - back * is_far) > sum(math.hypot(*size) / 2 for size in sizes):
            return False, False, False
        has_met = overlap_area(covered, self.corners(other)) > 1e-12
        if is_far and not has_met:
            covered = hull(covered + [(x - back, y - aside) for x, y in covered])
            return overlap_area(covered, self.corners(other)) > 1e-12, True, True
        return has_met, is_far, False

    def collide(self):
        """Record every pair of colliding rectangles, ordered by the front one, from the front."""
        for rank, ahead in enumerate(self.cars):
            for behind in self.cars[rank + 1 :]:
                is_hit, is_far, is_on_way = self.is_hit_by(ahead, behind)
                if not is_hit:
                    continue
                front, rear = ahead, behind
                if is_far and ahead.before[0] < behind.before[0]:
                    front, rear = behind, ahead
                front.is_hit = rear.is_hit = True
                closing = rear.speed - front.speed
                before = front.position - rear.position + closing * self.scenario.time_step
                if is_on_way:
                    before = front.before[0] - rear.before[0]
                length = (self.size(rear)[0] + self.size(front)[0]) / 2
                kind = CollisionKind.SIDE if abs(before) < length else CollisionKind.REAR_END
                self.collisions.append(
                    {
                        "step": self.counts["step"],
                        "rear_id": rear.id,
                        "front_id": front.id,
                        "rear_command": rear.agent.command if rear.agent else -1,
                        "front_command": front.agent.command if front.agent else -1,
                        "kind": kind,
                        "position": rear.position,
                        "closing_speed": closing,
                    }
                )
                self.counts["num_collisions"] += 1

    def remove(self):
        for car in self.cars:
            self.counts["num_collided"] += car.is_hit
            self.counts["num_off_road"] += car.is_off_road and not car.is_hit
            self.counts["num_left"] += not car.is_hit and (car.is_off_road or car.is_past_end)
        gone = [c for c in self.cars if c.is_hit or c.is_off_road or c.is_past_end]
        self.cars = [c for c in self.cars if c not in gone]
        # Their slots can be read until the next step, so they are not free before.
        self.removed = {car.slot for car in gone}
        self.counts["num_removed"] = len(gone)

    def depart(self):
        """At most one vehicle per lane, if the gap is at least its driver's desired gap.

        If not all due vehicles find a place, the one that has waited longest takes it.
        """
        scenario = self.scenario
        now = self.counts["step"] * scenario.time_step
        lanes = [lane for lane, (due, *_) in enumerate(self.departures) if due <= now]
        if len(lanes) > scenario.max_vehicles - len(self.cars) - len(self.removed):
            lanes.sort(key=lambda lane: self.departures[lane][0])
        for lane in lanes:
            taken = {car.slot for car in self.cars} | self.removed
            if len(taken) == scenario.max_vehicles:
                self.counts["num_held_back"] += 1
                continue
            _, speed, name = self.departures[lane]
            slot = next(slot for slot in range(scenario.max_vehicles) if slot not in taken)
            car = Car(self.counts["num_entered"], slot, 0.0, self.centre(lane), speed, 0.0, 0.0,
                      0.0, 0.0, 0.0, 0.0, lane, name, Disposition.NEUTRAL)  # fmt: skip
            driver = scenario.drivers.profiles[name]
            b = min(driver.comfortable_braking, scenario.vehicle.max_braking)
            a_lat, at = driver.comfortable_lateral_acceleration, car.lateral_position
            car.speed = min(speed, self.curve_speed(0.0, at, speed, a_lat, b))
            car.yaw_rate = self.turn_rate(car)
            in_lane = [other for other in self.cars if self.is_in(other, lane)]
            profile = scenario.drivers.profiles[name]
            if in_lane:
                front = in_lane[-1]
                a_m, headway = profile.max_acceleration, profile.time_headway
                term = self.interaction(car, front, profile, headway, a_m)
                if term > 1.0 or self.gap(car, front) <= 0.0:
                    continue
            speeds = profile.desired_speed or scenario.departures.desired_speed
            car.desired_speed = self.random.uniform(*speeds)
            names = [*SCRIPTED, *self.external_names]
            shares = {code: scenario.followers.mix.get(x, 0.0) for code, x in enumerate(names)}
            car.disposition = self.random.choose(shares)
            car.command_position = self.random.uniform(*scenario.command.position)
            self.cars.append(car)
            self.counts["num_entered"] += 1
            self.departures[lane] = self.next_departure(now)

    def next_departure(self, now):
        """Time, speed and profile of a lane's next vehicle."""
        scenario = self.scenario
        due = now + self.random.uniform(*scenario.departures.interval)
        speed = self.random.uniform(*scenario.departures.initial_speed)
        mix = scenario.drivers.mix
        name = self.random.choose({n: mix.get(n, 0.0) for n in scenario.drivers.profiles})
        return [due, speed, name]
