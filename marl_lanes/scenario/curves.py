"""A road's curves, and how far lane keeping deviates from the lane's centre in them."""

import math
from collections.abc import Sequence

from pydantic import Field

from marl_lanes.scenario.fields import NonNegative, Positive, Real, Section

_JOIN_TIME = 3.0
"""[s] Two opposite curves with less time between them count as one change of curvature."""


class Arc(Section):
    """A curve: constant curvature between two clothoids, with linear curvature in these."""

    start: NonNegative = Field(
        le=100_000.0, description="where the arc begins [m], 0 to 100,000, < end"
    )
    end: Positive = Field(
        le=100_000.0, description="where the arc ends [m], 0 to 100,000, > start, <= road.length"
    )
    radius: Real = Field(
        ge=-1e9,
        le=1e9,
        description="radius at the road's right edge [m], -1e9 to 1e9, |radius| >= 50; positive "
        "bends left",
    )
    transition: NonNegative = Field(
        50.0,
        le=50_000.0,
        description="length of the clothoid at each end, within start to end [m], 0 (a step of "
        "curvature) to (end - start)/2, at most 50,000",
    )


def deviation_in_curves(
    arcs: Sequence[Arc],
    *,
    road_width: float,
    lateral_acceleration: float,
    top_speed: float,
    pole: float,
    max_yaw_acceleration: float,
) -> list[float]:
    """How far lane keeping deviates from the lane's centre at the start of each arc [m].

    At the curve's speed v the change of curvature dc needs the lateral acceleration D = v^2 |dc|,
    and the yaw rate v |dc| within T = L/v, L the clothoid's length::

        max(D min(2/(e p)^2, 1/(T p^3)), 0.53 D max(0, v |dc|/alpha_max - T)^2)

    The first term is the peak of the linear response with three poles p, to a step and to a ramp.
    The second is for a yaw acceleration that is at its bound for most of the time; its factor is a
    fit to simulations (tests/scenario/test_curves.py compares it with others). If the curve before
    bends the other way and is near, dc includes its curvature, at the lower of the two speeds.

    Args:
        arcs: ascending.
        road_width: [m].
        lateral_acceleration: largest one of the driver in a curve [m/s^2].
        top_speed: highest speed of any driver [m/s].
        pole: p of lane keeping [rad/s].
        max_yaw_acceleration: alpha_max of lane keeping [rad/s^2].
    """
    # The path with the smallest radius, and the speed on it.
    radii = [abs(arc.radius) - (road_width if arc.radius > 0.0 else 0.0) for arc in arcs]
    speeds = [min(top_speed, math.sqrt(lateral_acceleration * radius)) for radius in radii]
    deviations = []
    for index, arc in enumerate(arcs):
        speed, change, length = speeds[index], 1.0 / radii[index], arc.transition
        if index > 0:
            before, slower = arcs[index - 1], min(speeds[index - 1 : index + 1])
            is_near = arc.start - before.end < _JOIN_TIME * slower
            if is_near and before.radius * arc.radius < 0.0:
                speed = slower
                change += 1.0 / radii[index - 1]
                length = 2.0 * min(length, before.transition)
        duration = length / speed
        demand = speed * speed * change
        step, ramp = 2.0 / (math.e * pole) ** 2, math.inf
        if duration > 0.0:
            ramp = 1.0 / (duration * pole**3)
        missing = max(0.0, speed * change / max_yaw_acceleration - duration)
        deviations.append(demand * max(min(step, ramp), 0.53 * missing * missing))
    return deviations
