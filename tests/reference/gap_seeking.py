"""The gap that a waiting driver seeks."""

import itertools
import math

from reference.flow import Flow

from marl_lanes.traffic.machine.state import Phase


class GapSeeking(Flow):
    """Acceleration toward the best of three gaps."""

    def window(self, car, pace, front, rear):
        """Lowest and highest position at which the rule accepts the car at this pace."""
        low, high, own = -math.inf, math.inf, self.size(car)[0]
        if front is not None:
            needed = self.needed(car, pace, pace - front.speed, car.desired_speed)
            high = front.position - (own + self.size(front)[0]) / 2 - needed
        if rear is not None:
            needed = self.needed(rear, rear.speed, rear.speed - pace, rear.desired_speed)
            low = rear.position + (own + self.size(rear)[0]) / 2 + needed
        return low, high

    def aim(self, car, front, rear):
        """Pace, the nearest point of the window (None without one), and the point to aim at."""
        top = car.desired_speed * self.scenario.gap.speed_factor
        pace = min((front or rear).speed, top)
        low, high = self.window(car, pace, front, rear)
        if rear is not None and low > car.position and min(rear.speed, top) > pace:
            pace = min(rear.speed, top)
            low, high = self.window(car, pace, front, rear)
        if math.isinf(low) and math.isinf(high) and low > high:
            return pace, None, car.position
        if low > high or low == math.inf or high == -math.inf:
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
