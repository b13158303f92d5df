"""The life of a command: which vehicles get one, the gap rule, phases, the outcome."""

import math
from dataclasses import replace

from reference.following import Following
from reference.records import Agent

from marl_lanes.traffic.machine.state import Outcome, Phase


class Commands(Following):
    """Commands, from the first step to the outcome."""

    @property
    def is_late(self):
        """Whether the episode is over or the horizon reached: no live agents, no new commands."""
        steps = round((self.scenario.horizon or math.inf) / self.scenario.time_step, 0)
        return self.counts["step"] == steps or bool(self.counts["is_done"])

    def deviation(self, agent):
        """From the car to the reference lane's centre, positive toward the target lane."""
        reference = agent.origin if agent.phase == Phase.ABORTING else agent.target
        return agent.direction * (self.centre(reference) - agent.car.lateral_position)

    def has_arrived(self, agent):
        return self.is_at(agent.car, self.deviation(agent))

    def is_at(self, car, deviation):
        """The completion criterion at a distance to a lane's centre."""
        rule = self.scenario.completion
        measured = (
            (deviation, rule.max_deviation),
            (car.speed * math.sin(car.yaw), rule.max_lateral_speed),
            (car.yaw_rate - self.turn_rate(car), rule.max_yaw_rate),
        )
        return all(bound is None or abs(value) <= bound for value, bound in measured)

    def outcome(self, agent):
        car = agent.car
        if car.is_hit:
            return Outcome.COLLISION
        if car.is_off_road:
            return Outcome.OFF_ROAD
        if agent.phase == Phase.ENGAGED and self.has_arrived(agent):
            return Outcome.COMPLETED
        if car.is_past_end:
            return Outcome.MISSED
        if self.is_timed_out(agent):
            return Outcome.TIMED_OUT
        if self.is_late:
            return Outcome.HORIZON
        return Outcome.UNFINISHED

    def is_timed_out(self, agent):
        limit = self.scenario.command.time_limit
        age = self.counts["step"] - agent.born
        return limit is not None and age >= round(limit / self.scenario.time_step)

    def lane_after(self, agent):
        """Where a car stays whose time is over: its body's lane nearest to where it drove.

        Or its body's a little later, if it drove on.
        """
        car, goal = agent.car, agent.target if agent.phase == Phase.ENGAGED else agent.origin
        later = car.lateral_position
        later += car.speed * math.sin(car.yaw) / self.scenario.lane_keeping.pole
        now, then = self.lanes_of(car), self.lanes_of(replace(car, lateral_position=later))
        lanes = range(min(now[0], then[0]), max(now[-1], then[-1]) + 1)
        return min(lanes, key=lambda lane: abs(lane - goal))

    def end(self, agent):
        if agent.outcome == Outcome.UNFINISHED:
            return
        if agent.outcome == Outcome.COMPLETED:
            agent.car.lane = agent.target
        elif agent.outcome == Outcome.TIMED_OUT:
            agent.car.lane = self.lane_after(agent)
        agent.car.agent = None
        self.counts["num_live"] -= 1
        self.counts["num_ended"] += 1

    def give_commands(self):
        scenario, counts = self.scenario, self.counts
        top = scenario.road.num_lanes - 1
        middle = [0, 1] if top == 1 else range(1, top)
        lanes = middle if scenario.command.lanes is None else scenario.command.lanes
        for car in self.cars:
            if car.position < car.command_position or car.moving_over:
                continue
            is_over = self.is_late or counts["num_commands"] == scenario.num_agents
            if counts["step"] < 0 or is_over or car.lane not in lanes:
                car.command_position = math.inf
                continue
            free = [slot for slot in range(scenario.num_slots) if slot not in self.agents]
            if not free:
                break
            car.command_position = math.inf
            if self.random.uniform(0.0, 1.0) >= scenario.command.probability:
                continue
            direction = {0: 1, top: -1}.get(car.lane)
            if direction is None:
                direction = 1 if self.random.uniform(0.0, 1.0) < 0.5 else -1
            number, origin = counts["num_commands"], car.lane
            target, born = origin + direction, counts["step"]
            car.agent = Agent(free[0], car, number, direction, origin, target, born)
            self.agents[free[0]] = car.agent
            counts["num_commands"] += 1
            counts["num_live"] += 1

    def is_gap_safe(self, rear, front, braking):
        """The scenario's gap rule; a missing vehicle is safe."""
        if rear is None or front is None:
            return True
        rule, gap = self.scenario.gap, self.gap(rear, front)
        if rule.rule == "car_following":
            profile = self.scenario.drivers.profiles[rear.profile]
            a_m, headway = profile.max_acceleration, profile.time_headway
            style = {"v0": rear.desired_speed, "a_m": a_m, "headway": headway, "scale_a_m": a_m}
            return (
                gap >= rule.minimum_gap and self.follow(rear, front, profile, **style) >= -braking
            )
        closing = max(0.0, rear.speed - front.speed)
        needed = rule.minimum_gap + rule.time_gap * rear.speed
        return gap >= needed + closing**2 / (2.0 * rule.max_braking)

    def is_accepted(self, agent):
        around, braking = agent.neighbors, self.scenario.gap.safe_braking
        if agent.phase == Phase.WAITING:
            braking -= self.scenario.gap.braking_margin
        return self.is_gap_safe(agent.car, around["target_leader"], braking) and self.is_gap_safe(
            around["target_follower"], agent.car, braking
        )

    def change_phase(self, agent):
        if agent.phase == Phase.WAITING:
            agent.phase = Phase.ENGAGED if self.is_accepted(agent) else Phase.WAITING
        elif agent.phase == Phase.ENGAGED:
            is_crossing = agent.target in self.lanes_of(agent.car)
            if not is_crossing and not self.is_accepted(agent):
                agent.phase = Phase.ABORTING
                agent.num_aborts += 1
        elif self.has_arrived(agent):
            agent.phase = Phase.WAITING
