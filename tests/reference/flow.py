"""Vehicles that enter, collide and leave."""

import math

from reference.command import Commands
from reference.geometry import overlap_area
from reference.records import SCRIPTED, Car

from marl_lanes.traffic.machine.state import CollisionKind, Disposition


class Flow(Commands):
    """Departures, collisions and removal."""

    def collide(self):
        """Record every pair of overlapping rectangles, ordered by the front one, from the front."""
        length = self.scenario.vehicle.length
        reach = math.hypot(length, self.scenario.vehicle.width)
        for rank, front in enumerate(self.cars):
            for rear in self.cars[rank + 1 :]:
                if front.position - rear.position > reach:
                    break
                if overlap_area(self.corners(rear), self.corners(front)) <= 1e-12:
                    continue
                front.is_hit = rear.is_hit = True
                closing = rear.speed - front.speed
                before = front.position - rear.position + closing * self.scenario.time_step
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
        """At most one vehicle per lane, if the gap is at least its driver's desired gap."""
        scenario = self.scenario
        now = self.counts["step"] * scenario.time_step
        for lane, (due, speed, name) in enumerate(self.departures):
            taken = {car.slot for car in self.cars} | self.removed
            if now < due or len(taken) == scenario.max_vehicles:
                continue
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
            car.desired_speed = self.random.uniform(*scenario.departures.desired_speed)
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
