"""Every measure of one maneuver, compared with values by hand from small traces."""

import math

import numpy as np
import pytest
from traces import maneuver, trace

from marl_lanes import load_scenario
from marl_lanes.evaluation.aftermath import Aftermath
from marl_lanes.evaluation.measures import measure
from marl_lanes.traffic.machine.state import Outcome, Phase

TOUCH = {"max_deviation": 0.2, "max_lateral_speed": None, "max_yaw_rate": None}
PAPER = load_scenario("paper", {"completion": TOUCH})


def measured(count=3, outcome=Outcome.MISSED, changes=None, **columns):
    return measure(maneuver(trace(count, **columns), outcome, **(changes or {})), PAPER)


def test_returns_are_sums_of_the_terms():
    found = measured(
        reward_yaw_acceleration=[-1.0, -0.5, 0.0],
        reward_yaw_rate=[-0.25, 0.0, -0.25],
        reward_deviation=[-0.125, -0.125, -0.0625],
    )
    assert found.returns["yaw_acceleration"] == -1.5
    assert found.returns["yaw_rate"] == -0.5
    assert found.returns["deviation"] == -0.3125
    assert found.return_ == -2.3125
    assert found.num_steps == 3
    assert found.duration == pytest.approx(0.3)
    assert (found.waiting_time, found.time_to_end) == (1.5, 9.0)


def test_peaks_are_relative_to_the_road():
    found = measured(
        speed=[10.0, 20.0, 30.0],
        yaw_rate=[0.05, -0.02, 0.03],
        turning=[0.03, -0.04, 0.01],
        yaw_acceleration=[0.3, -0.45, 0.1],
    )
    # Yaw rate relative to the road: 0.03, -0.04, 0.01; times the speed: 0.3, -0.8, 0.3 m/s^2.
    assert found.peak_yaw_acceleration == 0.45
    assert found.peak_yaw_rate == pytest.approx(0.04)
    assert found.peak_lateral_acceleration == pytest.approx(0.8)
    # With the road's turning: 10 * 0.05, 20 * -0.02, 30 * 0.03.
    assert found.peak_total_lateral_acceleration == pytest.approx(0.9)


@pytest.mark.parametrize(
    ("lateral", "jerk"),
    [
        # A jump to 1 m/s^2 is 2 m/s^3 over half a second, for any duration.
        ([1.0], 2.0),
        ([1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0], 2.0),
        ([0.2, 0.4, 0.6, 0.8, 1.0, 1.2, 1.4], 2.0),
        # From 1 to -1 within the window, and not within it.
        ([1.0, 0.0, 0.0, 0.0, 0.0, -1.0], 4.0),
        ([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0], 2.0),
    ],
)
def test_jerk_is_averaged_over_half_a_second(lateral, jerk):
    found = measured(len(lateral), turning=np.asarray(lateral) / 20.0)
    assert found.peak_lateral_jerk == pytest.approx(jerk)


@pytest.mark.parametrize(
    ("accelerations", "jerk"),
    [
        # Averaged over a second: a jump by 2 m/s^2 is 2 m/s^3, and so is a ramp of a second.
        ([-2.0] * 3, 2.0),
        (np.linspace(-0.2, -2.0, 10), 2.0),
        ([1.0] * 10 + [-1.0] * 2, 2.0),
        ([1.0] * 5 + [-1.5] * 2, 1.5),
    ],
)
def test_longitudinal_jerk_is_averaged_over_a_second(accelerations, jerk):
    found = measured(len(accelerations), acceleration=accelerations)
    assert found.peak_longitudinal_jerk == pytest.approx(jerk)


def test_jerk_does_not_bridge_two_attempts():
    """Nothing is recorded between them: the second attempt starts from the state before it."""
    steps = [1, 2, 3, 40, 41, 42]
    columns = {
        "step": steps,
        "turning": np.array([1.0, 1.0, 1.0, -1.0, -1.0, -1.0]) / 20.0,
        "turning_before": np.array([1.0, 1.0, 1.0, -1.0, -1.0, -1.0]) / 20.0,
        "acceleration": [0.0, 0.0, 0.0, -3.0, -3.0, -3.0],
        "acceleration_before": [0.0, 0.0, 0.0, -2.5, -3.0, -3.0],
    }
    found = measured(6, **columns)
    assert found.peak_lateral_jerk == 0.0
    assert found.peak_longitudinal_jerk == pytest.approx(0.5)
    together = measured(6, **(columns | {"step": np.arange(6)}))
    assert together.peak_lateral_jerk == pytest.approx(4.0)
    assert together.peak_longitudinal_jerk == pytest.approx(3.0)
    assert math.isnan(measured(0).peak_lateral_jerk)


def test_what_became_of_it():
    deviation = np.array([0.1, 0.3, -0.25, 0.1])
    aftermath = Aftermath(-0.5, has_left_lane=True, watched_time=0.3, deviation=deviation)
    found = measured(outcome=Outcome.COMPLETED, changes={"aftermath": aftermath}).after
    assert (found.is_good, found.is_lost, found.has_collided) == (False, False, False)
    assert (found.has_left_lane, found.watched_time) == (True, 0.3)
    assert (found.lateral_speed_at_completion, found.peak_deviation_after) == (0.5, 0.3)
    assert found.settling_time == pytest.approx(0.3)
    assert measured().after is None


@pytest.mark.parametrize(
    ("acceleration", "expected"),
    [([0.5, -1.5, np.nan], 1.5), ([0.5, 0.2, 1.0], 0.0), ([np.nan] * 3, math.nan)],
)
def test_follower_braking(acceleration, expected):
    found = measured(follower_acceleration=acceleration).max_follower_braking
    assert found == pytest.approx(expected, nan_ok=True)


@pytest.mark.parametrize(
    ("acceleration", "expected"), [([0.5, -2.5, -1.5], 2.5), ([0.5, 0.25, 1.0], 0.0)]
)
def test_the_changers_own_braking(acceleration, expected):
    assert measured(acceleration=acceleration).max_changer_braking == expected
    assert math.isnan(measured(0).max_changer_braking)


def test_the_optimum_is_of_the_last_attempt():
    phases = [Phase.ENGAGED] * 5 + [Phase.ABORTING] * 5 + [Phase.ENGAGED] * 30
    deviation = np.linspace(3.75, 0.2, 40)
    deviation[10] = 3.7
    rows = trace(40, phase=phases, deviation_before=deviation)
    later = measure(maneuver(rows, Outcome.COMPLETED), PAPER).optimal_return
    assert later == measure(maneuver(rows[10:], Outcome.COMPLETED), PAPER).optimal_return
    # At 20 m/s a whole lane costs 3.33 (test_optimum.py).
    assert later == pytest.approx(-3.33, rel=0.03)
    assert math.isnan(measure(maneuver(rows), PAPER).optimal_return)
    without = measure(maneuver(rows, Outcome.COMPLETED), PAPER, with_optimum=False)
    assert math.isnan(without.optimal_return)
