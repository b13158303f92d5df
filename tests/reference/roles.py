"""Observations and rewards of changers and followers, and their pairs."""

import math

from reference.driving import Driving
from reference.records import Follower

from marl_lanes.traffic.machine.state import Disposition, Outcome, Phase

BOUNDS = {
    "speed": (-150.0, 150.0),
    "acceleration": (-20.0, 20.0),
    "deviation": (-100.0, 100.0),
    "gap": (-20.0, 10_000.0),
    "yaw_rate": (-150.0, 150.0),
    "time": (0.0, 1e6),
    "distance_to_end": (-100.0, 100_000.0),
}
"""Bounds of features, by the end of their names; the others cannot be beyond theirs."""


def clip(name, value):
    """A feature within its bounds."""
    for end, (low, high) in BOUNDS.items():
        if name.endswith(end):
            return min(max(value, low), high)
    return value


class Roles(Driving):
    """Observations, rewards and pairs."""

    def judge(self, agent):
        """The reward, with Eq. 10, Eq. 11 and Eq. 12, and the outcome."""
        weights, car, outcome = self.scenario.reward, agent.car, self.outcome(agent)
        has_failed = outcome in (Outcome.COLLISION, Outcome.OFF_ROAD)
        agent.terms = dict.fromkeys(("yaw_acceleration", "yaw_rate", "deviation"), 0.0)
        agent.terms["failure"] = -weights.failure_penalty if has_failed else 0.0
        agent.terms["delay"] = -weights.delay_weight * self.scenario.time_step
        agent.terms["longitudinal"] = 0.0
        if self.scenario.action.longitudinal is not None:
            departure = car.acceleration - agent.car_following
            agent.terms["longitudinal"] = -weights.longitudinal_weight * departure**2
        if agent.is_steering:
            agent.steering_steps += 1
            turning = car.yaw_rate - self.turn_rate(car)
            share = abs(self.deviation(agent)) / weights.average_deviation
            steering = abs(car.yaw_acceleration)
            agent.terms["yaw_acceleration"] = -weights.yaw_acceleration_weight * steering
            agent.terms["yaw_rate"] = -weights.yaw_rate_weight * abs(turning)
            agent.terms["deviation"] = -weights.deviation_weight * share
        agent.reward = sum(agent.terms.values())
        agent.episode_reward += agent.reward
        if outcome == Outcome.UNFINISHED:
            return
        self.look(agent)
        agent.outcome = outcome

    def renew(self):
        """Phases from the front of the road to its rear; then observations, then followers.

        The slots of the agents have no influence.
        """
        live = [car.agent for car in self.cars if car.agent is not None]
        for agent in live:
            self.find_neighbors(agent)
            self.change_phase(agent)
        for agent in live:
            self.look(agent)
        engaged = [agent for agent in live if agent.phase == Phase.ENGAGED]
        for car in self.cars:
            claims = [one.car for one in engaged if one.neighbors["target_follower"] is car]
            car.changer = min(claims, key=lambda other: other.position, default=None)

    def pair(self):
        """Rewards of the drivers paired in this step; then new pairs and observations."""
        before, self.followers = self.followers, {}
        for slot, agent in self.agents.items():
            follower = self.followers[slot] = before.get(slot, Follower())
            if follower.car is None:
                follower.be_unpaid()
            else:
                self.pay(follower, agent)
            driver = agent.neighbors["target_follower"]
            is_engaged = agent.phase == Phase.ENGAGED and agent.outcome == Outcome.UNFINISHED
            is_external = driver is not None and driver.disposition >= Disposition.EXTERNAL
            is_paired = is_engaged and is_external and driver.changer is agent.car
            follower.car = driver if is_paired and driver.agent is None else None
            follower.observation = [0.0] * 9 if driver is None else self.seen_behind(agent, driver)

    def pay(self, follower, agent):
        """The five terms of a driver that was paired with a changer in this step."""
        weights, acceleration = self.scenario.followers.learned.reward, follower.car.acceleration
        is_in_lane = agent.target in self.lanes_of(agent.car)
        braking = max(0.0, -acceleration - weights.hard_braking)
        delay = weights.delay_weight * self.scenario.time_step
        follower.terms = {
            "delay": 0.0 if is_in_lane else delay,
            "abort": weights.abort_weight if agent.phase == Phase.ABORTING else 0.0,
            "collision": -weights.collision_penalty if follower.car.is_hit else 0.0,
            "discomfort": -weights.discomfort_weight * acceleration**2,
            "braking": -weights.braking_weight * braking,
        }
        follower.reward = sum(follower.terms.values())
        follower.episode_reward += follower.reward

    def seen_behind(self, agent, driver):
        """Observation of a changer's target follower, column by column."""
        changer, leader = agent.car, agent.neighbors["target_leader"]
        reach, phase = self.scenario.observation.sensor_range, agent.phase
        gap, relative_speed, deviation = reach, 0.0, self.deviation(agent)
        if leader is not None:
            gap, relative_speed = self.gap(driver, leader), leader.speed - driver.speed
        if agent.outcome != Outcome.UNFINISHED:
            # The command is over: the deviation is from the target lane.
            phase = Phase.ABSENT
            deviation = agent.direction * (self.centre(agent.target) - changer.lateral_position)
        sideways = agent.direction * changer.speed * math.sin(changer.yaw)
        return [
            clip("speed", driver.speed),
            clip("acceleration", driver.acceleration),
            clip("gap", min(self.gap(driver, changer), reach)),
            clip("speed", changer.speed - driver.speed),
            clip("deviation", deviation),
            clip("speed", sideways),
            clip("gap", min(gap, reach)),
            clip("speed", relative_speed),
            float(phase),
        ]

    def find_neighbors(self, agent):
        for prefix, lane in (("", agent.origin), ("target_", agent.target)):
            is_there = lambda car, lane=lane: self.is_in(car, lane)  # noqa: E731
            agent.neighbors[f"{prefix}leader"] = self.ahead(agent.car, is_there)
            agent.neighbors[f"{prefix}follower"] = self.behind(agent.car, is_there)

    @property
    def columns(self):
        """Names of what is observed in one step."""
        observation = self.scenario.observation
        names, grid = list(observation.features), observation.grid
        for kind in ("occupied", "cell_speed") if grid else ():
            for lane in range(grid.num_lanes):
                names += [f"{kind}_{lane}_{stretch}" for stretch in range(grid.num_stretches)]
        return names

    def grid(self, agent):
        """The cells of the occupancy grid by name, each looked at by itself."""
        seen, size = {}, self.scenario.observation.grid
        for lane in range(size.num_lanes) if size else ():
            place = agent.origin + agent.direction * (lane - size.num_lanes // 2)
            for stretch in range(size.num_stretches):
                rear = agent.car.position + (stretch - size.num_stretches / 2) * size.stretch
                bodies = [
                    car
                    for car in self.cars
                    if car is not agent.car
                    and place in self.lanes_of(car)
                    and car.position + self.size(car)[0] / 2 >= rear
                    and car.position - self.size(car)[0] / 2 < rear + size.stretch
                ]
                # Of several the one furthest behind.
                faster = bodies[-1].speed - agent.car.speed if bodies else 0.0
                seen[f"occupied_{lane}_{stretch}"] = 1.0 if bodies else 0.0
                seen[f"cell_speed_{lane}_{stretch}"] = faster
        return seen

    def look(self, agent):
        """Find the neighbors, and set every feature by name; keep those of the steps before."""
        self.find_neighbors(agent)
        car, sign = agent.car, agent.direction
        before, seen = agent.observation, {}
        agent.observation = seen
        seen["speed"], seen["acceleration"] = car.speed, car.acceleration
        seen["lateral_deviation"] = self.deviation(agent)
        seen["lateral_speed"] = sign * car.speed * math.sin(car.yaw)
        seen["yaw"] = math.atan2(math.sin(sign * car.yaw), math.cos(sign * car.yaw))
        seen["yaw_rate"] = sign * car.yaw_rate
        seen["curvature"] = sign * self.curvature(car.position)
        seen["phase"] = float(agent.phase)
        seen["time"] = (self.counts["step"] - agent.born) * self.scenario.time_step
        seen["car_following_acceleration"] = self.would_follow(agent)
        seen["distance_to_end"] = self.scenario.road.length - car.position
        reach = self.scenario.observation.sensor_range
        for name, other in agent.neighbors.items():
            seen[f"{name}_gap"], seen[f"{name}_relative_speed"] = reach, 0.0
            if other is not None:
                rear, front = (car, other) if name.endswith("leader") else (other, car)
                seen[f"{name}_gap"] = min(self.gap(rear, front), reach)
                seen[f"{name}_relative_speed"] = other.speed - car.speed
        for name, value in seen.items():
            seen[name] = clip(name, value)
        seen |= self.grid(agent)
        for name in self.columns:
            for steps in range(1, self.scenario.observation.num_stacked):
                source = name if steps == 1 else f"{name}@{steps - 1}"
                seen[f"{name}@{steps}"] = before.get(source, seen[name])
