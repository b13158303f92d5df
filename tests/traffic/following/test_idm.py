"""The formulas of car following: numbers by hand."""

import math

import pytest

from marl_lanes.traffic.following.idm import (
    acc_acceleration,
    constant_acceleration_heuristic,
    free_road_term,
    idm_acceleration,
    interaction_term,
)

SCALE = 2.0 * math.sqrt(2.0 * 1.5)
"""2 sqrt(a_m b) of the paper: 3.4641 m/s^2."""


@pytest.mark.parametrize(
    ("speed", "desired", "exponent", "term"),
    [
        (20.0, 25.0, 4.0, 0.4096),
        (25.0, 25.0, 4.0, 1.0),
        (0.0, 25.0, 4.0, 0.0),
        (10.0, 20.0, 2.0, 0.25),
        (10.0, 20.0, 1.0, 0.5),
    ],
)
def test_free_road_term(speed, desired, exponent, term):
    assert free_road_term(speed, desired, exponent) == pytest.approx(term, rel=1e-12)


def test_interaction_term_by_hand():
    # s* = 5 + 20 * 1 + 20 * 5/3.464102 = 53.867513; (53.867513/30)^2 = 3.224121
    term = interaction_term(20.0, 30.0, 5.0, 5.0, 1.0, SCALE)
    assert term == pytest.approx(3.2241211, rel=1e-6)


def test_eq_9_takes_the_larger_term_and_the_standard_form_their_sum():
    free, interaction = 0.4096, 3.2241211
    assert idm_acceleration(2.0, free, interaction, 0) == pytest.approx(-4.4482422)
    assert idm_acceleration(2.0, free, interaction, 1) == pytest.approx(-5.2674422)
    assert idm_acceleration(2.0, free, 0.1, 0) == pytest.approx(1.1808)
    assert idm_acceleration(2.0, free, 0.1, 1) == pytest.approx(0.9808)


@pytest.mark.parametrize("speed", [0.0, 5.0, 20.0])
def test_the_desired_gap_at_equal_speeds_is_s0_plus_v_t(speed):
    term = interaction_term(speed, 5.0 + 1.2 * speed, 0.0, 5.0, 1.2, SCALE)
    assert term == pytest.approx(1.0)
    assert idm_acceleration(2.0, 0.3, term, 0) == pytest.approx(0.0, abs=1e-12)


def test_a_leader_that_pulls_away_fast_is_no_obstacle():
    assert interaction_term(10.0, 50.0, -1000.0, 5.0, 1.0, SCALE) == pytest.approx(0.01)


@pytest.mark.parametrize("gap", [0.0, -3.0, 1e-300])
def test_contact_gives_a_finite_huge_term(gap):
    term = interaction_term(20.0, gap, 0.0, 5.0, 1.0, SCALE)
    assert 1e6 < term < math.inf


@pytest.mark.parametrize(
    ("speed", "gap", "front_speed", "front_acceleration", "expected"),
    [
        # Equal speeds, a leader with constant speed: 0.
        (20.0, 10.0, 20.0, 0.0, 0.0),
        # Closing at 5 m/s, gap 25 m: -25/50.
        (20.0, 25.0, 15.0, 0.0, -0.5),
        # A leader that brakes with 4 m/s^2 from 15 m/s: 15 * 5 <= 2 * 25 * 4, both stop,
        # 20^2 * -4/(15^2 + 2 * 25 * 4).
        (20.0, 25.0, 15.0, -4.0, -1600.0 / 425.0),
        # It brakes too little for that: 15 * 5 > 2 * 25 * 1; -1 - 25/50.
        (20.0, 25.0, 15.0, -1.0, -1.5),
        # Its acceleration counts up to the driver's own a_m = 2.
        (20.0, 25.0, 20.0, 3.0, 2.0),
        # It remains at a standstill: -v^2/(2 s).
        (20.0, 50.0, 0.0, 0.0, -4.0),
        (0.0, 5.0, 0.0, 0.0, 0.0),
        (0.0, 5.0, 0.0, -2.0, 0.0),
    ],
)
def test_the_constant_acceleration_heuristic_by_hand(
    speed, gap, front_speed, front_acceleration, expected
):
    found = constant_acceleration_heuristic(speed, gap, front_speed, front_acceleration, 2.0)
    assert found == pytest.approx(expected, abs=1e-12)


def test_the_acc_model_by_hand():
    # The IDM brakes less: its value is used.
    assert acc_acceleration(-1.0, -2.0, 1.5, 0.99) == -1.0
    # 0.01 * -10 + 0.99 (-0.5 + 1.5 tanh(-9.5/1.5))
    assert acc_acceleration(-10.0, -0.5, 1.5, 0.99) == pytest.approx(-2.0799906, abs=1e-6)
    assert acc_acceleration(-10.0, -0.5, 1.5, 0.0) == -10.0


@pytest.mark.parametrize(
    ("speed", "gap", "closing", "expected"),
    [
        # Standstill at no gap, or at a negative one: (5/0.01)^2 = 250,000; 2 (1 - 250,000).
        (0.0, 0.0, 0.0, -499_998.0),
        (0.0, -4.8, 0.0, -499_998.0),
        # Standstill at s0: 2 (1 - 1).
        (0.0, 5.0, 0.0, 0.0),
        # Nobody ahead, at half of v0: 2 (1 - 1/16). At v0: 0. At twice v0: 2 (1 - 16).
        (10.0, math.inf, 0.0, 1.875),
        (20.0, math.inf, 0.0, 0.0),
        (40.0, math.inf, 0.0, -30.0),
        (0.0, math.inf, 0.0, 2.0),
        # No gap at 10 m/s behind a vehicle at a standstill: s* = 5 + 10 + 100/3.4641.
        (10.0, 0.0, 10.0, 2.0 * (1.0 - ((15.0 + 100.0 / SCALE) / 0.01) ** 2)),
    ],
)
def test_extremes_by_hand(speed, gap, closing, expected):
    """a_m = 2, v0 = 20, s0 = 5, T = 1: finite for every gap and speed."""
    free = free_road_term(speed, 20.0, 4.0)
    term = interaction_term(speed, gap, closing, 5.0, 1.0, SCALE)
    assert idm_acceleration(2.0, free, term, 0) == pytest.approx(expected)


def test_the_smallest_desired_speed_and_the_largest_exponent_give_a_finite_number():
    free = free_road_term(70.0, 0.1, 20.0)
    assert free == pytest.approx(700.0**20)
    braking = idm_acceleration(10.0, free, 0.0, 1)
    assert braking == pytest.approx(-(700.0**20) * 10.0)
    # With the coolness 1 nothing of it is left: a_CAH - b.
    assert acc_acceleration(braking, -1.0, 1.5, 1.0) == pytest.approx(-2.5)
