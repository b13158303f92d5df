"""Positions: curvature, lanes, corners of the bodies, vehicles ahead and behind."""

import math

from reference.records import SCRIPTED

from marl_lanes.traffic.machine.state import Phase


class Geometry:
    """The cars of one road, from the front to the rear, and the road's shape."""

    def __init__(self, scenario):
        self.scenario = scenario
        self.cars, self.agents, self.collisions, self.counts = [], {}, [], {}
        self.followers, self.departures = {}, []
        self.external_names = [name for name in scenario.followers.mix if name not in SCRIPTED]
        self.known_lanes = {}

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

    def turn_rate(self, car):
        """Turning rate of the road under the car: c s'."""
        c = self.curvature(car.position)
        # Beside the road, towards the arc's centre, as at half the radius.
        share = min(c * car.lateral_position, 0.5)
        return c * car.speed * math.cos(car.yaw) / (1.0 - share)

    def size(self, car):
        """Length and width of the car, its profile's or every vehicle's."""
        own, every = self.scenario.drivers.profiles[car.profile], self.scenario.vehicle
        return own.length or every.length, own.width or every.width

    def corners(self, car):
        """Corners of the rectangle, counter-clockwise."""
        half_length, half_width = (size / 2 for size in self.size(car))
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
        pose = car.lateral_position, car.yaw, car.profile
        if pose not in self.known_lanes:
            width, last = self.scenario.road.lane_width, self.scenario.road.num_lanes - 1
            across = [corner[1] for corner in self.corners(car)]
            low, high = math.floor(min(across) / width), math.floor(max(across) / width)
            self.known_lanes[pose] = range(min(max(low, 0), last), min(max(high, 0), last) + 1)
        return self.known_lanes[pose]

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
        return front.position - rear.position - (self.size(rear)[0] + self.size(front)[0]) / 2

    @staticmethod
    def is_bound_for(car, lane):
        """Whether it is engaged toward the lane, or moving over to it."""
        if car.agent is None:
            return bool(car.moving_over) and car.lane == lane
        return car.agent.phase == Phase.ENGAGED and car.agent.target == lane


def shape(arc, position):
    """An arc's curvature divided by its largest one, from 0 up to 1."""
    if arc.transition == 0.0:
        return 1.0
    return min(1.0, (position - arc.start) / arc.transition, (arc.end - position) / arc.transition)


def hull(points):
    """The convex hull of points, counter-clockwise: the lower edge to the right, then the upper."""
    edges = []
    for ordered in (sorted(points), sorted(points, reverse=True)):
        edge = []
        for x, y in ordered:
            while len(edge) > 1 and (
                (edge[-1][0] - edge[-2][0]) * (y - edge[-2][1])
                <= (edge[-1][1] - edge[-2][1]) * (x - edge[-2][0])
            ):
                edge.pop()
            edge.append((x, y))
        edges += edge[:-1]
    return edges


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
