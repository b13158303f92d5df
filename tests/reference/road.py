"""A slow reference of one time step, in plain Python, after docs/model.md and the paper.

``Road.of(simulator)`` takes one road's snapshot; ``road.step(actions, follower_actions)`` advances
it. Only the enumerations and the state's names come from the package: every formula is written
here a second time.
"""

import math

from philox import Random
from reference.records import Agent, Car, Follower
from reference.roles import Roles

from marl_lanes.traffic.machine.state import ROAD, Outcome, Phase

KEEPING_MIN_SPEED = 1.0


class Road(Roles):
    """One road of a scenario: ``cars`` from the front to the rear."""

    @classmethod
    def of(cls, simulator, env=0):
        """A snapshot of a simulator's road."""
        state, road = simulator.state, cls(simulator.scenario)
        record = state.roads[env]
        for name in record.dtype.names:
            if not name.startswith("random"):
                road.counts[name] = int(record[name])
        road.random = Random(*(int(record[f"random_{x}"]) for x in ("key", "stream", "counter")))
        names = list(road.scenario.drivers.profiles)
        road.departures = [
            [float(lane["next_departure"]), float(lane["next_speed"]), names[lane["next_profile"]]]
            for lane in state.lanes[env]
        ]
        floats = [name for name, (kind, *_) in state.vehicles.dtype.fields.items() if kind == "f8"]
        by_slot = {}
        for slot in state.order[env, : record["num_vehicles"]].tolist():
            row = state.vehicles[env, slot]
            car = Car(
                id=int(row["id"]),
                slot=slot,
                **{name: float(row[name]) for name in floats},
                lane=int(row["lane"]),
                moving_over=int(row["moving_over"]),
                profile=names[row["profile"]],
                disposition=int(row["disposition"]),
            )
            by_slot[slot] = car
            road.cars.append(car)
        for car in road.cars:
            car.changer = by_slot.get(int(state.vehicles[env, car.slot]["changer"]))
        for slot, row in enumerate(state.agents[env]):
            if row["phase"] == Phase.ABSENT:
                continue
            car = by_slot[int(row["vehicle"])]
            names = "command", "direction", "origin_lane", "target_lane", "born_step"
            car.agent = road.agents[slot] = Agent(slot, car, *(int(row[name]) for name in names))
            car.agent.phase = Phase(int(row["phase"]))
            car.agent.num_aborts = int(row["num_aborts"])
            car.agent.steering_steps = int(row["steering_steps"])
            car.agent.episode_reward = float(row["episode_reward"])
            seen = state.observations[env, slot].reshape(road.scenario.observation.num_stacked, -1)
            for steps, values in enumerate(seen.tolist()):
                names = [f"{name}@{steps}" if steps else name for name in road.columns]
                car.agent.observation |= dict(zip(names, values, strict=True))
            follower = by_slot.get(int(row["target_follower"]))
            car.agent.neighbors["target_follower"] = follower
            behind = state.followers[env, slot]
            driver = by_slot.get(int(behind["vehicle"]))
            total = float(behind["episode_reward"])
            road.followers[slot] = Follower(driver, episode_reward=total)
        return road

    @classmethod
    def after_reset(cls, scenario, seed):
        """Road 0 of a seed after its reset: empty, then a warm-up without commands."""
        road = cls(scenario)
        road.counts = {name: 0 for name, *_ in ROAD if not name.startswith("random")}
        road.random = Random(seed, 0, 0)
        start = -math.ceil(road.random.uniform(*scenario.warmup) / scenario.time_step)
        now, road.counts["step"] = start * scenario.time_step, start
        for _ in range(scenario.road.num_lanes):
            _, speed, name = road.next_departure(now)
            # The road begins at a random time between two departures.
            due = now + road.random.uniform(0.0, scenario.departures.interval[1])
            road.departures.append([due, speed, name])
        for _ in range(-start):
            road.step([], [])
        return road

    def step(self, actions, follower_actions):
        """One time step, given by agent slot the actions and the accelerations of the followers."""
        self.forget()
        if self.scenario.followers.cooperative.moves_over:
            for car in self.cars:
                self.move_over(car)
        # From the front to the rear: the ACC model uses the leader's new acceleration.
        for car in self.cars:
            car.acceleration = self.drive(car, actions, follower_actions)
        for car in self.cars:
            self.move(car, actions)
        self.counts["step"] += 1
        self.counts["num_ended"] = 0
        self.cars.sort(key=lambda car: -car.position)
        self.collide()
        for agent in self.agents.values():
            self.judge(agent)
        for agent in self.agents.values():
            self.end(agent)
        self.remove()
        self.depart()
        self.give_commands()
        self.renew()
        if self.external_names:
            self.pair()
        self.finish()

    def forget(self):
        """Free the slots of the commands that ended in the step before."""
        for slot, agent in list(self.agents.items()):
            if agent.outcome != Outcome.UNFINISHED:
                del self.agents[slot]
                self.followers.pop(slot, None)
        self.known_lanes.clear()

    def move(self, car, actions):
        """Steer, then semi-implicit Euler; the road's turning is from before the step."""
        scenario, turn_rate = self.scenario, self.turn_rate(car)
        if car.agent is not None and car.agent.is_steering:
            bound = scenario.action.max_yaw_acceleration
            action = min(max(actions[car.agent.slot][0], -bound), bound)
            car.yaw_acceleration = car.agent.direction * action
        else:
            pole, bound = scenario.lane_keeping.pole, scenario.lane_keeping.max_yaw_acceleration
            sideways = min(1.0, 0.15 * max(car.speed, KEEPING_MIN_SPEED))
            error = self.centre(car.lane) - car.lateral_position
            error = math.copysign(min(abs(error), 3 * sideways / pole), error)
            steering = pole**3 * error / max(car.speed, KEEPING_MIN_SPEED)
            steering -= 3 * pole**2 * car.yaw + 3 * pole * (car.yaw_rate - turn_rate)
            car.yaw_acceleration = min(max(steering, -bound), bound)
        step, before = scenario.time_step, (car.speed, car.yaw_rate)
        car.before = car.position, car.lateral_position
        car.speed = max(0.0, car.speed + car.acceleration * step)
        fastest = car.speed / scenario.vehicle.min_turning_radius
        car.yaw_rate = min(max(car.yaw_rate + car.yaw_acceleration * step, -fastest), fastest)
        # The applied values, which differ from the wanted ones at a bound.
        car.acceleration = (car.speed - before[0]) / step
        car.yaw_acceleration = (car.yaw_rate - before[1]) / step
        car.yaw += (car.yaw_rate - turn_rate) * step
        c = self.curvature(car.position)
        along = car.speed * math.cos(car.yaw) / (1.0 - c * car.lateral_position)
        car.advance = along * step
        car.position += along * step
        car.lateral_position += car.speed * math.sin(car.yaw) * step
        across = [corner[1] for corner in self.corners(car)]
        width = scenario.road.num_lanes * scenario.road.lane_width
        is_turned = abs(car.yaw) >= math.pi / 2
        car.is_off_road = min(across) < 0.0 or max(across) > width or is_turned
        car.is_past_end = car.position >= scenario.road.length

    def finish(self):
        counts = self.counts
        counts["num_vehicles"] = len(self.cars)
        is_last_over = (
            counts["num_commands"] == self.scenario.num_agents and counts["num_live"] == 0
        )
        steps = round((self.scenario.horizon or math.inf) / self.scenario.time_step, 0)
        if counts["step"] == steps:
            ended = [agent.outcome for agent in self.agents.values()]
            counts["is_cut"] = int(not is_last_over or Outcome.HORIZON in ended)
        if is_last_over or self.is_late:
            counts["is_done"] = 1
