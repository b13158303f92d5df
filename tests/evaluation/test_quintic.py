"""The quintic polynomial, compared with its conditions and with the search over its durations."""

import numpy as np
import pytest

from marl_lanes.evaluation import quintic
from marl_lanes.evaluation.quintic import COST_OF_TIME, DURATIONS, steer_by_quintic

STEP = 0.1
STATES = np.array([[3.75, 0.0, 0.0], [1.5, 0.03, -0.004], [-0.4, -0.01, 0.02]])


def polynomial(e, rate, acceleration, duration):
    """Its coefficients, the highest first, by the six conditions."""
    conditions = []
    for t in (0.0, duration):
        powers = [np.poly1d([1.0] + [0.0] * k) for k in range(5, -1, -1)]
        conditions += [[power.deriv(order)(t) for power in powers] for order in range(3)]
    return np.poly1d(np.linalg.solve(conditions, [e, rate, acceleration, 0.0, 0.0, 0.0]))


def cost(found, duration):
    squared = (found.deriv(3) ** 2).integ()
    return squared(duration) - squared(0.0) + COST_OF_TIME * duration


@pytest.mark.parametrize("state", STATES)
def test_the_action_begins_the_cheapest_polynomial(state):
    speed = 20.0
    deviation, yaw, yaw_rate = state
    start = deviation, -speed * yaw, -speed * yaw_rate
    candidates = [(polynomial(*start, t), t) for t in DURATIONS]
    best, duration = min(candidates, key=lambda one: cost(*one))
    assert DURATIONS[0] < duration < DURATIONS[-1]
    wanted = -best.deriv(2)(STEP) / speed
    (action,) = steer_by_quintic(np.array([speed]), *state[:, np.newaxis], STEP)
    assert yaw_rate + action * STEP == pytest.approx(wanted, rel=1e-9)


def drive(speed, time_step):
    """Deviations until it has settled, from one lane away."""
    e, psi, w = np.array([3.75]), np.zeros(1), np.zeros(1)
    found = []
    while abs(e[0]) > 0.05 or abs(psi[0]) > 1e-3:
        w = w + time_step * steer_by_quintic(np.array([speed]), e, psi, w, time_step)
        psi = psi + time_step * w
        e = e - time_step * speed * np.sin(psi)
        found.append(e[0])
        assert len(found) * time_step < 20.0
    return np.array(found)


def test_the_plans_of_one_change_are_one_plan(monkeypatch):
    """The rest of the cheapest polynomial is the cheapest one from where the vehicle is."""
    monkeypatch.setattr(quintic, "DURATIONS", np.arange(0.5, 9.01, 0.05))
    step = 0.01
    first = min(
        ((polynomial(3.75, 0.0, 0.0, t), t) for t in quintic.DURATIONS), key=lambda one: cost(*one)
    )
    found = drive(20.0, step)
    times = step * np.arange(1, len(found) + 1)
    is_before = times < first[1]
    assert is_before.sum() > 400
    assert found[is_before] == pytest.approx(first[0](times[is_before]), abs=0.03)


def test_it_settles_at_any_speed():
    for speed in (2.0, 10.0, 20.0, 40.0):
        found = drive(speed, STEP)
        assert found.min() > -0.25
        assert 3.0 < len(found) * STEP < 9.0


def test_nothing_for_nobody():
    nobody = np.zeros(0)
    assert steer_by_quintic(nobody, nobody, nobody, nobody, STEP).shape == (0,)
