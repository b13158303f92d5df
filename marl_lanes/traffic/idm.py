"""Car following: the paper's Eq. 9 and the standard Intelligent Driver Model."""

import math

from marl_lanes.traffic.compiled import compiled

_CONTACT_GAP = 0.01
"""[m] Gaps are not taken as smaller, so that bumper contact gives a finite, huge term."""


@compiled
def free_road_term(speed: float, desired_speed: float, exponent: float) -> float:
    """(v/v0)^delta: what holds a driver back on a free road.

    Args:
        speed: v [m/s].
        desired_speed: v0 [m/s], > 0.
        exponent: delta [1].

    Source: Eq. 9; Treiber, Hennecke, Helbing 2000.
    """
    ratio = speed / desired_speed
    if exponent == 4.0:
        square = ratio * ratio
        return square * square
    return math.pow(ratio, exponent)


@compiled
def interaction_term(
    speed: float,
    gap: float,
    closing_speed: float,
    minimum_gap: float,
    time_headway: float,
    braking_scale: float,
) -> float:
    """(s*/s)^2 with s* = s0 + max(0, v T + v dv/(2 sqrt(a_m b))).

    The paper prints the gap s under the root, which is dimensionally wrong; Treiber's form is
    meant. The maximum keeps a leader that pulls away fast from looking like an obstacle.

    Args:
        speed: v [m/s].
        gap: s, bumper to bumper [m].
        closing_speed: dv = v - v_leader [m/s].
        minimum_gap: s0 [m].
        time_headway: T [s].
        braking_scale: 2 sqrt(a_m b) [m/s^2].

    Source: Eq. 9; Treiber, Hennecke, Helbing 2000, eq. 4.
    """
    dynamic = speed * (time_headway + closing_speed / braking_scale)
    ratio = (minimum_gap + max(0.0, dynamic)) / max(gap, _CONTACT_GAP)
    return ratio * ratio


@compiled
def idm_acceleration(
    max_acceleration: float, free_road: float, interaction: float, is_sum_form: int
) -> float:
    """a_m (1 - max(free, interaction)), or with their sum in the standard form [m/s^2].

    Args:
        max_acceleration: a_m [m/s^2].
        free_road: ``free_road_term`` [1].
        interaction: the largest ``interaction_term`` over the leaders [1], 0 without one.
        is_sum_form: 1 for the standard IDM, 0 for the paper's Eq. 9.

    Source: Eq. 9 (max); Treiber, Hennecke, Helbing 2000, eq. 3 (sum).
    """
    if is_sum_form:
        return max_acceleration * (1.0 - free_road - interaction)
    return max_acceleration * (1.0 - max(free_road, interaction))
