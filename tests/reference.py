"""A slow reference of one time step, in plain Python, after docs/model.md and the paper.

``Road.of(simulator)`` takes one road's snapshot; ``road.step(actions, follower_actions)`` advances
it. Only the enumerations and the state's names come from the package: every formula is written
here a second time.
"""

import itertools
import math
from dataclasses import dataclass, field

from philox import Random

from marl_lanes.traffic.machine.state import CollisionKind, Disposition, Outcome, Phase

KEEPING_MIN_SPEED = 1.0
CONTACT_GAP = 0.01
SCRIPTED = ["cooperative", "neutral", "adversarial"]
FOLLOWER_TERMS = "delay", "abort", "collision", "discomfort", "braking"


@dataclass(eq=False)
class Car:
    """A vehicle; lengths in the road frame."""

    id: int
    slot: int
    position: float
    lateral_position: float
    speed: float
    acceleration: float
    yaw: float
    yaw_rate: float
    yaw_acceleration: float
    desired_speed: float
    command_position: float
    lane: int
    profile: str
    disposition: int
    moving_over: int = 0
    agent: "Agent | None" = None
    changer: "Car | None" = None
    is_off_road: bool = False
    is_past_end: bool = False
    is_hit: bool = False


@dataclass(eq=False)
class Agent:
    """A live command."""

    slot: int
    car: Car
    command: int
    direction: int
    origin: int
    target: int
    born: int
    phase: Phase = Phase.WAITING
    outcome: Outcome = Outcome.UNFINISHED
    num_aborts: int = 0
    steering_steps: int = 0
    car_following: float = 0.0
    terms: dict = field(default_factory=dict)
    reward: float = 0.0
    episode_reward: float = 0.0
    neighbors: dict = field(default_factory=dict)
    observation: dict = field(default_factory=dict)

    @property
    def is_steering(self):
        return self.phase in (Phase.ENGAGED, Phase.ABORTING)


@dataclass(eq=False)
class Follower:
    """Record of the external driver behind the changer of a live command."""

    car: Car | None = None
    terms: dict = field(default_factory=lambda: dict.fromkeys(FOLLOWER_TERMS, 0.0))
    reward: float = 0.0
    episode_reward: float = 0.0
    observation: list = field(default_factory=list)


class Road:
    """One road of a scenario: ``cars`` from the front to the rear."""

    def __init__(self, scenario):
        self.scenario = scenario
        self.cars, self.agents, self.collisions, self.counts = [], {}, [], {}
        self.followers = {}
        self.external_names = [name for name in scenario.followers.mix if name not in SCRIPTED]
        self.known_lanes = {}

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
            follower = by_slot.get(int(row["target_follower"]))
            car.agent.neighbors["target_follower"] = follower
            behind = state.followers[env, slot]
            driver = by_slot.get(int(behind["vehicle"]))
            total = float(behind["episode_reward"])
            road.followers[slot] = Follower(driver, episode_reward=total)
        return road

    def step(self, actions, follower_actions):
        """One time step, given by agent slot the actions and the accelerations of the followers."""
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

    # Geometry

    def centre(self, lane):
        return self.scenario.road.lane_width * lane + self.scenario.road.lane_width / 2

    def curvature(self, position):
        for arc in self.scenario.road.arcs:
            if arc.start <= position < arc.end:
                return shape(arc, position) / arc.radius
        return 0.0

    def curve_speed(self, position, lateral, preview, a_lat, b):
        """The least over places ahead of the speed allowed there, plus braking with b before it."""
        squares = [math.inf]
        for arc in self.scenario.road.arcs:
            length = arc.transition
            # The clothoid's end, both ends of the preview, and the place with derivative 0.
            places = [arc.start + length, position, position + preview]
            places.append(arc.start + math.sqrt(a_lat * length * abs(arc.radius) / (2 * b)))
            for place in places:
                # Beyond its first clothoid the arc is not sharper than at the clothoid's end.
                is_ahead = max(arc.start, position) <= place < arc.end
                if is_ahead and (place == position or place <= arc.start + length):
                    bend = shape(arc, place)
                    radius = abs(arc.radius / bend - lateral) if bend > 0.0 else math.inf
                    squares.append(a_lat * radius + 2 * b * max(0.0, place - position - preview))
        return math.sqrt(min(squares))

    def in_curves(self, car, b):
        """The acceleration toward the curve's speed."""
        a_lat = self.scenario.drivers.profiles[car.profile].comfortable_lateral_acceleration
        b = min(b, self.scenario.vehicle.max_braking)
        allowed = self.curve_speed(car.position, car.lateral_position, car.speed, a_lat, b)
        return (allowed - car.speed) / 0.5

    def turn_rate(self, car):
        """Turning rate of the road under the car: c s'."""
        c = self.curvature(car.position)
        return c * car.speed * math.cos(car.yaw) / (1.0 - c * car.lateral_position)

    def corners(self, car):
        """Corners of the rectangle, counter-clockwise."""
        half_length, half_width = self.scenario.vehicle.length / 2, self.scenario.vehicle.width / 2
        cos, sin = math.cos(car.yaw), math.sin(car.yaw)
        return [
            (
                car.position + x * half_length * cos - y * half_width * sin,
                car.lateral_position + x * half_length * sin + y * half_width * cos,
            )
            for x, y in ((1, 1), (-1, 1), (-1, -1), (1, -1))
        ]

    def lanes_of(self, car):
        """The lanes that the body overlaps."""
        pose = car.lateral_position, car.yaw
        if pose not in self.known_lanes:
            width, last = self.scenario.road.lane_width, self.scenario.road.num_lanes - 1
            across = [corner[1] for corner in self.corners(car)]
            low, high = math.floor(min(across) / width), math.floor(max(across) / width)
            self.known_lanes[pose] = range(min(max(low, 0), last), min(max(high, 0), last) + 1)
        return self.known_lanes[pose]

    # Neighbors

    def is_in(self, car, lane):
        """Whether its body is in the lane, or it is bound for it."""
        return lane in self.lanes_of(car) or self.is_bound_for(car, lane)

    def ahead(self, car, is_candidate):
        """The nearest car ahead of ``car`` that is a candidate, or None."""
        front = self.cars[: self.cars.index(car)]
        return next((other for other in reversed(front) if is_candidate(other)), None)

    def behind(self, car, is_candidate):
        rear = self.cars[self.cars.index(car) + 1 :]
        return next((other for other in rear if is_candidate(other)), None)

    def gap(self, rear, front):
        return front.position - rear.position - self.scenario.vehicle.length

    # Car following

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

    # The gap that a waiting driver seeks

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

    def window(self, car, pace, front, rear):
        """Lowest and highest position at which the rule accepts the car at this pace."""
        length, low, high = self.scenario.vehicle.length, -math.inf, math.inf
        if front is not None:
            needed = self.needed(car, pace, pace - front.speed, car.desired_speed)
            high = front.position - length - needed
        if rear is not None:
            needed = self.needed(rear, rear.speed, rear.speed - pace, rear.desired_speed)
            low = rear.position + length + needed
        return low, high

    def aim(self, car, front, rear):
        """Pace, the nearest point of the window (None without one), and the point to aim at."""
        top = car.desired_speed * self.scenario.gap.speed_factor
        pace = min((front or rear).speed, top)
        low, high = self.window(car, pace, front, rear)
        if rear is not None and low > car.position and min(rear.speed, top) > pace:
            pace = min(rear.speed, top)
            low, high = self.window(car, pace, front, rear)
        if low > high:
            return pace, None, (low + high) / 2.0
        inset = min(3.0, (high - low) / 2.0)
        point = min(max(car.position, low), high)
        return pace, point, min(max(car.position, low + inset), high - inset)

    def arrival(self, car, pace, point):
        """Time until the car is at the point that moves at this pace, and as fast; inf if never."""
        if point is None:
            return math.inf
        profile = self.scenario.drivers.profiles[car.profile]
        way, b = point - car.position, profile.comfortable_braking
        top = pace / 2.0
        if way > 0.0:
            top = car.desired_speed * self.scenario.gap.speed_factor - pace
        time = fastest(way, car.speed - pace, b, top)
        leader = self.ahead(car, lambda other: self.is_in(other, car.lane))
        if leader is None or time == math.inf:
            return time
        gap = self.gap(car, leader) + (leader.speed - pace) * time - way
        return time if gap >= profile.minimum_gap + profile.time_headway * pace else math.inf

    def seek(self, car):
        """Acceleration of a waiting driver toward the best of three gaps; inf without one."""
        if car.agent is None or car.agent.phase != Phase.WAITING:
            return math.inf
        reach, target = self.scenario.observation.sensor_range, car.agent.target
        rank = self.cars.index(car)
        ahead = [c for c in reversed(self.cars[:rank]) if self.is_in(c, target)] + [None]
        behind = [c for c in self.cars[rank + 1 :] if self.is_in(c, target)] + [None]
        choices = []
        if ahead[0] or behind[0]:
            choices.append((ahead[0], behind[0]))
        further = [
            [(b, a) for a, b in itertools.pairwise(ahead)],
            list(itertools.pairwise(behind)),
        ]
        for gaps in further:
            for front, rear in gaps:
                near = rear if gaps is further[0] else front
                if abs(near.position - car.position) >= reach:
                    break
                choices.append((front, rear))
                if self.aim(car, front, rear)[1] is not None:
                    break
        best, wanted = math.inf, math.inf
        for front, rear in choices:
            pace, point, aim = self.aim(car, front, rear)
            time = self.arrival(car, pace, point)
            if time < best:
                best, wanted = time, self.track(car, pace, aim)
        return wanted

    def hold(self, car):
        """Lower bound of a changer's acceleration toward its target leader, until it is there."""
        target = car.agent.target
        if car.agent.phase != Phase.ENGAGED or target in self.lanes_of(car):
            return -math.inf
        front = self.ahead(car, lambda other: self.is_in(other, target))
        rear = self.behind(car, lambda other: self.is_in(other, target))
        if front is None and rear is None:
            return math.inf
        pace, _, aim = self.aim(car, front, rear)
        return self.track(car, pace, aim)

    def track(self, car, pace, aim):
        """Toward an aim that moves at this pace: 1 s for the speed, 5 s for the distance."""
        wanted = max(pace + (aim - car.position) / 5.0, pace / 2.0)
        gentle = self.scenario.drivers.profiles[car.profile].comfortable_braking
        return max(wanted - car.speed, -gentle)

    def hurry(self, car):
        """Factor of the desired speed because of a gap."""
        factor = self.scenario.gap.speed_factor
        if car.agent is None:
            return 1.0
        if self.seek(car) < math.inf:
            return factor
        if car.agent.phase == Phase.ENGAGED and car.agent.target not in self.lanes_of(car):
            return min(max(1.0, car.speed / car.desired_speed), factor)
        return 1.0

    def leaders_beyond(self, car):
        """The leaders in a changing car's target lane, and bound for it; None is in the list."""
        if car.agent is None and not car.moving_over:
            return [None]
        target = car.lane if car.agent is None else car.agent.target
        in_lane = self.ahead(car, lambda other: target in self.lanes_of(other))
        changing = self.ahead(car, lambda other: self.is_bound_for(other, target))
        return [None, in_lane, changing]

    @staticmethod
    def is_bound_for(car, lane):
        """Whether it is engaged toward the lane, or moving over to it."""
        if car.agent is None:
            return bool(car.moving_over) and car.lane == lane
        return car.agent.phase == Phase.ENGAGED and car.agent.target == lane

    # Yielding by moving over

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

    # Motion

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
        car.speed = max(0.0, car.speed + car.acceleration * step)
        fastest = car.speed / scenario.vehicle.min_turning_radius
        car.yaw_rate = min(max(car.yaw_rate + car.yaw_acceleration * step, -fastest), fastest)
        # The applied values, which differ from the wanted ones at a bound.
        car.acceleration = (car.speed - before[0]) / step
        car.yaw_acceleration = (car.yaw_rate - before[1]) / step
        car.yaw += (car.yaw_rate - turn_rate) * step
        c = self.curvature(car.position)
        along = car.speed * math.cos(car.yaw) / (1.0 - c * car.lateral_position)
        car.position += along * step
        car.lateral_position += car.speed * math.sin(car.yaw) * step
        across = [corner[1] for corner in self.corners(car)]
        width = scenario.road.num_lanes * scenario.road.lane_width
        is_turned = abs(car.yaw) >= math.pi / 2
        car.is_off_road = min(across) < 0.0 or max(across) > width or is_turned
        car.is_past_end = car.position >= scenario.road.length

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

    # The command's life

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
        if self.is_late:
            return Outcome.HORIZON
        return Outcome.UNFINISHED

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

    def end(self, agent):
        if agent.outcome == Outcome.UNFINISHED:
            return
        if agent.outcome == Outcome.COMPLETED:
            agent.car.lane = agent.target
        agent.car.agent = None
        self.counts["num_live"] -= 1
        self.counts["num_ended"] += 1

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
            due = now + self.random.uniform(*scenario.departures.interval)
            speed = self.random.uniform(*scenario.departures.initial_speed)
            mix = scenario.drivers.mix
            name = self.random.choose({n: mix.get(n, 0.0) for n in scenario.drivers.profiles})
            self.departures[lane] = [due, speed, name]

    def give_commands(self):
        scenario, counts = self.scenario, self.counts
        middle = range(1, scenario.road.num_lanes - 1)
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

    def pair(self):
        """Rewards of the drivers paired in this step; then new pairs and observations."""
        before, self.followers = self.followers, {}
        for slot, agent in self.agents.items():
            follower = self.followers[slot] = before.get(slot, Follower())
            if follower.car is not None:
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
        return [
            driver.speed,
            driver.acceleration,
            min(self.gap(driver, changer), reach),
            changer.speed - driver.speed,
            deviation,
            agent.direction * changer.speed * math.sin(changer.yaw),
            min(gap, reach),
            relative_speed,
            float(phase),
        ]

    def find_neighbors(self, agent):
        for prefix, lane in (("", agent.origin), ("target_", agent.target)):
            is_there = lambda car, lane=lane: self.is_in(car, lane)  # noqa: E731
            agent.neighbors[f"{prefix}leader"] = self.ahead(agent.car, is_there)
            agent.neighbors[f"{prefix}follower"] = self.behind(agent.car, is_there)

    def look(self, agent):
        """Find the neighbors, and set every feature by name."""
        self.find_neighbors(agent)
        car, sign = agent.car, agent.direction
        seen = agent.observation
        seen["speed"], seen["acceleration"] = car.speed, car.acceleration
        seen["lateral_deviation"] = self.deviation(agent)
        seen["lateral_speed"] = sign * car.speed * math.sin(car.yaw)
        seen["yaw"], seen["yaw_rate"] = sign * car.yaw, sign * car.yaw_rate
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


def shape(arc, position):
    """An arc's curvature divided by its largest one, from 0 up to 1."""
    if arc.transition == 0.0:
        return 1.0
    return min(1.0, (position - arc.start) / arc.transition, (arc.end - position) / arc.transition)


def fastest(way, speed, limit, top):
    """Least time to cover a distance and stop; |acceleration| <= limit, speed toward it <= top."""
    stop = speed * abs(speed) / (2.0 * limit)
    sign = 1.0 if way >= stop else -1.0
    way, speed = sign * way, sign * speed
    # Up to the peak and down to 0: (peak^2 - speed^2 + peak^2)/(2 limit) = way.
    peak = math.sqrt(limit * way + speed**2 / 2.0)
    if peak > top:
        if top <= 0.0:
            return math.inf
        cruise = way - (2.0 * top**2 - speed**2) / (2.0 * limit)
        return (top - speed) / limit + top / limit + cruise / top
    return (peak - speed) / limit + peak / limit


def overlap_area(subject, clip):
    """Area of the intersection of two convex counter-clockwise polygons, by clipping."""
    for (x0, y0), (x1, y1) in zip(clip, clip[1:] + clip[:1], strict=True):

        def side(p, x0=x0, y0=y0, x1=x1, y1=y1):
            return (x1 - x0) * (p[1] - y0) - (y1 - y0) * (p[0] - x0)

        kept = []
        for p, q in zip(subject, subject[1:] + subject[:1], strict=True):
            if side(p) >= 0.0:
                kept.append(p)
            if side(p) * side(q) < 0.0:
                t = side(p) / (side(p) - side(q))
                kept.append((p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1])))
        subject = kept
        if not subject:
            return 0.0
    edges = zip(subject, subject[1:] + subject[:1], strict=True)
    return 0.5 * sum(p[0] * q[1] - q[0] * p[1] for p, q in edges)
