"""The speed of drivers in curves and before them."""

import math
from typing import Any

from marl_lanes.traffic.machine.compiled import compiled, internal
from marl_lanes.traffic.road.geometry import arc_curvature

_PREVIEW = 1.0
"""[s] Braking for a curve begins this much earlier than necessary, so it begins gently."""

_RESPONSE = 0.5
"""[s] Time constant toward the allowed speed; it must be at most half the preview."""


@compiled
def curve_speed(
    position: float,
    lateral_position: float,
    preview: float,
    lateral_acceleration: float,
    braking: float,
    arcs: Any,
) -> float:
    """The highest speed at which all curves ahead can be taken; inf without a curve [m/s].

    min over the positions p ahead of sqrt(a_lat/|k(p)| + 2 b max(0, p - s - preview)), where
    k = c/(1 - c d) is the curvature of the path at the present lateral position d. For each
    arc the minimum is at the largest curvature within the preview or, beyond the preview, in its
    first clothoid, of length L, with the curvature x c/L at the distance x from its start.
    There the sum is least at x = sqrt(a_lat L/(2 b |c|)) if x < L, otherwise at the clothoid's end.

    Args:
        position: s [m].
        lateral_position: d [m].
        preview: length of road ahead before braking begins [m].
        lateral_acceleration: a_lat, the largest in a curve [m/s^2].
        braking: b, ahead of a curve [m/s^2].
        arcs: (K,) ARC, ascending.
    """
    far = position + preview
    square = math.inf
    for index in range(arcs.shape[0]):
        arc = arcs[index]
        if arc.end <= position:
            continue
        sharpest = math.sqrt(
            0.5 * lateral_acceleration * arc.transition / (braking * abs(arc.curvature))
        )
        place = min(max(far, arc.start + sharpest), arc.start + arc.transition)
        place = max(place, position)
        curvature = arc_curvature(arc, place)
        # The curvature is 0 at the ends of an arc: it does not bound the speed.
        if curvature != 0.0:
            radius = abs(1.0 / curvature - lateral_position)
            room = 2.0 * braking * max(0.0, place - far)
            square = min(square, lateral_acceleration * radius + room)
    return math.sqrt(square)


@internal
def _allowed_speed(
    car: Any, lateral_acceleration: float, braking: float, arcs: Any, constants: Any
) -> float:
    """``curve_speed`` at the car's position, with the preview at its speed [m/s].

    Args:
        car: the vehicle.
        lateral_acceleration: a_lat, the largest in a curve [m/s^2].
        braking: b, ahead of a curve [m/s^2]; at most the physical limit is used.
        arcs: (K,) ARC, ascending.
        constants: of the scenario.
    """
    return float(
        curve_speed(
            car.position,
            car.lateral_position,
            _PREVIEW * car.speed,
            lateral_acceleration,
            min(braking, constants.max_braking),
            arcs,
        )
    )


@internal
def curve_acceleration(
    car: Any, lateral_acceleration: float, braking: float, arcs: Any, constants: Any
) -> float:
    """(v_allowed - v)/0.5 s, toward the allowed speed; inf on a straight road [m/s^2].

    The arguments are those of ``_allowed_speed``.
    """
    if arcs.shape[0] == 0:
        return math.inf
    allowed = _allowed_speed(car, lateral_acceleration, braking, arcs, constants)
    return float((allowed - car.speed) / _RESPONSE)


@internal
def entry_speed(car: Any, profile: Any, arcs: Any, constants: Any) -> float:
    """The speed of an entering vehicle: its own, or that allowed by the curves ahead [m/s]."""
    lateral, braking = profile.comfortable_lateral_acceleration, profile.comfortable_braking
    return float(min(car.speed, _allowed_speed(car, lateral, braking, arcs, constants)))
