"""Car-following formulas: the paper's Eq. 9, the Intelligent Driver Model, the ACC model."""

import math

from marl_lanes.traffic.machine.compiled import compiled

_CONTACT_GAP = 0.01
"""[m] Lower bound of the gap, so that the term at bumper contact is large but finite."""


@compiled
def free_road_term(speed: float, desired_speed: float, exponent: float) -> float:
    """(v/v0)^delta, the free-road term.

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

    The paper prints the gap s under the root, which is dimensionally wrong; this is Treiber's
    form. Without the maximum a leader that pulls away fast would have the effect of an obstacle.

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


@compiled
def constant_acceleration_heuristic(
    speed: float,
    gap: float,
    front_speed: float,
    front_acceleration: float,
    max_acceleration: float,
) -> float:
    """a_CAH, which just avoids a collision if the leader keeps its acceleration [m/s^2].

    v^2 a_l/(v_l^2 - 2 s a_l) if v_l (v - v_l) <= -2 s a_l, where both come to a standstill;
    otherwise a_l - max(0, v - v_l)^2/(2 s). a_l = min(the leader's acceleration, a_m).

    Args:
        speed: v [m/s].
        gap: s, bumper to bumper [m].
        front_speed: v_l [m/s].
        front_acceleration: the leader's acceleration [m/s^2].
        max_acceleration: a_m [m/s^2].

    Source: Kesting, Treiber, Helbing 2010, eq. 2.3.
    """
    s = max(gap, _CONTACT_GAP)
    front = min(front_acceleration, max_acceleration)
    closing = speed - front_speed
    reach = front_speed * front_speed - 2.0 * s * front
    # reach is 0 behind a leader that remains at a standstill: the other formula applies there.
    if front_speed * closing <= -2.0 * s * front and reach > 0.0:
        return speed * speed * front / reach
    closing = max(0.0, closing)
    return front - closing * closing / (2.0 * s)


@compiled
def acc_acceleration(
    acceleration: float, heuristic: float, comfortable_braking: float, coolness: float
) -> float:
    """a_IDM if a_IDM >= a_CAH, else (1 - c) a_IDM + c (a_CAH + b tanh((a_IDM - a_CAH)/b)).

    Args:
        acceleration: a_IDM, in the standard form [m/s^2].
        heuristic: a_CAH, ``constant_acceleration_heuristic`` [m/s^2].
        comfortable_braking: b [m/s^2], > 0.
        coolness: c [1], 0 (the IDM) to 1.

    Source: Kesting, Treiber, Helbing 2010, eq. 2.4.
    """
    if acceleration >= heuristic:
        return acceleration
    excess = (acceleration - heuristic) / comfortable_braking
    cool = heuristic + comfortable_braking * math.tanh(excess)
    return (1.0 - coolness) * acceleration + coolness * cool
