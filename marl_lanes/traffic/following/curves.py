"""How fast a driver takes the curves that lie ahead."""

import math
from typing import Any

from marl_lanes.traffic.machine.compiled import compiled, internal
from marl_lanes.traffic.road.geometry import arc_curvature

_PREVIEW = 1.0
"""[s] Braking for a curve begins this long before the latest moment, to begin gently."""

_RESPONSE = 0.5
"""[s] The speed approaches the allowed one with this time constant, at most half the preview."""


@compiled
def curve_speed(
    position: float,
    lateral_position: float,
    preview: float,
    lateral_acceleration: float,
    braking: float,
    arcs: Any,
) -> float:
    """The highest speed from which every curve ahead can be taken, inf without one [m/s].

    min over the positions p ahead of sqrt(a_lat/|k(p)| + 2 b max(0, p - s - preview)), where
    k = c/(1 - c d) is the curvature of the path at the present lateral position d. The minimum of
    an arc lies where its curvature is largest within the preview or, beyond that, in the clothoid
    at its beginning, of length L and curvature x c/L after x: there the sum is least at
    x = sqrt(a_lat L/(2 b |c|)), if x < L, or at the clothoid's end.

    Args:
        position: s [m].
        lateral_position: d [m].
        preview: length of road that must be taken without further braking [m].
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
        # A road that hardly bends, at an arc's outermost end, bounds no speed.
        if curvature != 0.0:
            radius = abs(1.0 / curvature - lateral_position)
            room = 2.0 * braking * max(0.0, place - far)
            square = min(square, lateral_acceleration * radius + room)
    return math.sqrt(square)


@internal
def _allowed_speed(
    car: Any, lateral_acceleration: float, braking: float, arcs: Any, constants: Any
) -> float:
    """``curve_speed`` where the car is, with the preview at its speed [m/s].

    Args:
        car: the vehicle.
        lateral_acceleration: a_lat, the largest in a curve [m/s^2].
        braking: b, ahead of a curve [m/s^2]; the physical limit where that is lower.
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
    """Toward the allowed speed within the response time; inf on a straight road [m/s^2].

    The arguments are those of ``_allowed_speed``.
    """
    if arcs.shape[0] == 0:
        return math.inf
    allowed = _allowed_speed(car, lateral_acceleration, braking, arcs, constants)
    return float((allowed - car.speed) / _RESPONSE)


@internal
def entry_speed(car: Any, profile: Any, arcs: Any, constants: Any) -> float:
    """The speed with which a vehicle enters: its own, or what the curves ahead allow [m/s]."""
    lateral, braking = profile.comfortable_lateral_acceleration, profile.comfortable_braking
    return float(min(car.speed, _allowed_speed(car, lateral, braking, arcs, constants)))
