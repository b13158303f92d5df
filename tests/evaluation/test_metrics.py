"""Every metric against values worked out by hand from small traces."""

import json
import math

import numpy as np
import pytest

from marl_lanes import load_scenario
from marl_lanes.evaluation.metrics import AVERAGES, evaluate, measure, summarise
from marl_lanes.evaluation.rollout import TRACE, Maneuver
from marl_lanes.traffic.state import Outcome, Phase

PAPER = load_scenario("paper")


def trace(count, **columns):
    """Rows at 20 m/s in the middle of nowhere, but for ``columns``."""
    rows = np.zeros(count, TRACE)
    rows["step"] = np.arange(1, count + 1)
    rows["phase"] = Phase.ENGAGED
    rows["speed"] = rows["speed_before"] = 20.0
    rows["direction"] = 1
    rows["deviation_before"] = 3.75
    rows["leader_gap"] = rows["follower_gap"] = rows["follower_gap_before"] = np.inf
    for name in ("leader_speed", "follower_speed", "follower_acceleration"):
        rows[name] = np.nan
    for name, values in columns.items():
        rows[name] = values
    return rows


def maneuver(rows, outcome=Outcome.MISSED, **changes):
    values = {
        "env": 0,
        "command": 0,
        "outcome": outcome,
        "num_aborts": 0,
        "born_step": 0,
        "waiting_time": 1.5,
        "time_to_end": 9.0,
        "has_side_collision": False,
        "episode_reward": -4.5,
        "trace": rows,
    }
    return Maneuver(**(values | changes))


def measured(count=3, outcome=Outcome.MISSED, changes=None, **columns):
    return measure(maneuver(trace(count, **columns), outcome, **(changes or {})), PAPER)


def test_returns_are_sums_of_the_terms():
    found = measured(
        reward_acceleration=[-1.0, -0.5, 0.0],
        reward_yaw_rate=[-0.25, 0.0, -0.25],
        reward_deviation=[-0.125, -0.125, -0.0625],
    )
    assert found.return_acceleration == -1.5
    assert found.return_yaw_rate == -0.5
    assert found.return_deviation == -0.3125
    assert found.return_ == -2.3125
    assert found.num_steps == 3
    assert found.duration == pytest.approx(0.3)
    assert (found.waiting_time, found.time_to_end) == (1.5, 9.0)


def test_peaks_are_relative_to_the_road():
    found = measured(
        speed=[10.0, 20.0, 30.0],
        yaw_rate=[0.05, -0.02, 0.03],
        road_turn_rate=[0.02, 0.02, 0.02],
        yaw_acceleration=[0.3, -0.45, 0.1],
    )
    # Turning beyond the road's: 0.03, -0.04, 0.01; by the speed: 0.3, -0.8, 0.3 m/s^2.
    assert found.peak_yaw_acceleration == 0.45
    assert found.peak_yaw_rate == pytest.approx(0.04)
    assert found.peak_lateral_acceleration == pytest.approx(0.8)


@pytest.mark.parametrize(
    ("lateral", "jerk"),
    [
        # A jump to 1 m/s^2 is 2 m/s^3 over half a second, however long it lasts.
        ([1.0], 2.0),
        ([1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0], 2.0),
        ([0.2, 0.4, 0.6, 0.8, 1.0, 1.2, 1.4], 2.0),
        # From 1 to -1 within the window, and not within it.
        ([1.0, 0.0, 0.0, 0.0, 0.0, -1.0], 4.0),
        ([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0], 2.0),
    ],
)
def test_jerk_is_averaged_over_half_a_second(lateral, jerk):
    found = measured(len(lateral), yaw_rate=np.asarray(lateral) / 20.0)
    assert found.peak_lateral_jerk == pytest.approx(jerk)


def test_overshoot_is_what_lies_beyond_the_centre():
    def overshoot(values, outcome=Outcome.COMPLETED):
        changes = {"residual_deviation": values}
        rows = maneuver(trace(3), outcome, **changes)
        return measure(rows, PAPER, with_optimum=False).residual_overshoot

    assert overshoot([-0.2, -0.1, 0.35, 0.1]) == 0.35
    assert overshoot([-0.2, -0.1]) == 0.0
    assert overshoot([]) == 0.0
    assert math.isnan(overshoot([0.5], Outcome.MISSED))


@pytest.mark.parametrize(
    ("columns", "expected"),
    [
        ({}, math.inf),
        ({"leader_gap": 30.0, "leader_speed": 15.0}, 6.0),
        ({"leader_gap": 30.0, "leader_speed": 25.0}, math.inf),
        ({"leader_gap": [30.0, 8.0, 50.0], "leader_speed": [15.0, 18.0, 10.0]}, 4.0),
        ({"follower_gap": 30.0, "follower_speed": 25.0}, 6.0),
        ({"follower_gap": 30.0, "follower_speed": 20.0}, math.inf),
        ({"follower_gap": -2.0, "follower_speed": 25.0}, math.inf),
        ({"leader_gap": [0.0, -1.0, 10.0], "leader_speed": 15.0}, 2.0),
        (
            {
                "leader_gap": 30.0,
                "leader_speed": 15.0,
                "follower_gap": 10.0,
                "follower_speed": 25.0,
            },
            2.0,
        ),
    ],
)
def test_time_to_collision(columns, expected):
    assert measured(**columns).min_time_to_collision == pytest.approx(expected)


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


@pytest.mark.parametrize(
    ("speed", "follower", "critical"),
    [
        # UN R79's example: 130 km/h behind 100 km/h.
        (100.0 / 3.6, 130.0 / 3.6, 42.7),
        (20.0, 20.0, 20.0),
        (20.0, 10.0, 20.0),
        (20.0, 26.0, 20.0 + 2.4 + 6.0),
    ],
)
def test_the_critical_distance(speed, follower, critical):
    def is_violated(gap, **changes):
        columns = {"is_over_marking": True, "speed": speed, "follower_speed": follower}
        return measured(**(columns | {"follower_gap": gap} | changes)).is_s_critical_violated

    assert is_violated(critical - 0.05) == 1.0
    assert is_violated(critical + 0.05) == 0.0
    assert math.isnan(is_violated(critical - 0.05, is_over_marking=False))
    assert math.isnan(is_violated(np.inf))
    # Only the first row at the marking counts.
    over = [False, True, True]
    assert is_violated([1.0, critical + 0.05, 1.0], is_over_marking=over) == 0.0
    assert is_violated([99.0, critical - 0.05, 99.0], is_over_marking=over) == 1.0


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


def sample():
    """One completed maneuver, one that collided, one that never engaged."""
    completed = trace(
        30,
        reward_acceleration=-0.1,
        reward_yaw_rate=-0.02,
        follower_acceleration=-0.5,
        acceleration=-0.25,
    )
    collided = trace(
        4,
        reward_deviation=-0.25,
        leader_gap=10.0,
        leader_speed=15.0,
        follower_acceleration=-1.5,
        acceleration=-6.0,
    )
    return [
        maneuver(completed, Outcome.COMPLETED, num_aborts=2, residual_deviation=[0.125]),
        maneuver(collided, Outcome.COLLISION, has_side_collision=True, num_aborts=1),
        maneuver(trace(0), Outcome.MISSED, waiting_time=6.0, episode_reward=-0.5),
        maneuver(trace(2), Outcome.OFF_ROAD, waiting_time=0.0),
    ]


def test_the_summary_counts_and_averages():
    found = evaluate(sample(), PAPER)
    assert found["num_maneuvers"] == 4
    for name in ("completion", "collision", "steering_collision", "missed", "off_road"):
        assert found[f"{name}_rate"] == 0.25, name
    assert found["horizon_rate"] == 0.0
    assert found["abort_rate"] == 0.5
    assert found["mean_num_aborts"] == 0.75
    # Two were turned back, another one was missed.
    assert found["abort_or_miss_rate"] == 0.75
    assert found["mean_episode_reward"] == -3.5
    assert found["mean_return"] == pytest.approx(-3.6)
    assert found["mean_return_acceleration"] == pytest.approx(-3.0)
    assert found["mean_return_yaw_rate"] == pytest.approx(-0.6)
    assert found["mean_return_deviation"] == 0.0
    assert found["mean_return_all"] == pytest.approx((-3.6 - 1.0) / 4)
    assert found["mean_optimal_return"] == pytest.approx(-3.33, rel=0.01)
    assert found["cost_ratio"] == pytest.approx(-3.6 / found["mean_optimal_return"])
    assert found["mean_num_steps"] == 30
    assert found["mean_duration"] == pytest.approx(3.0)
    assert found["mean_waiting_time"] == pytest.approx((1.5 + 1.5 + 6.0) / 4)
    assert found["mean_time_to_completion"] == 9.0
    assert found["mean_residual_overshoot"] == found["max_residual_overshoot"] == 0.125
    assert found["mean_max_follower_braking"] == found["max_follower_braking"] == 0.5
    assert found["mean_max_changer_braking"] == found["max_changer_braking"] == 0.25
    # Of all with a follower: the completed one and the one that collided.
    assert found["mean_max_follower_braking_all"] == 1.0
    assert found["max_follower_braking_all"] == 1.5
    assert found["min_time_to_collision"] == pytest.approx(2.0)
    assert found["s_critical_violation_rate"] is None


def test_means_and_largest_are_over_the_completed_ones():
    rows = [
        maneuver(trace(3, yaw_acceleration=[0.1, -0.3, 0.0]), Outcome.COMPLETED),
        maneuver(trace(3, yaw_acceleration=[0.1, 0.0, 0.0]), Outcome.COMPLETED),
        maneuver(trace(3, yaw_acceleration=[0.5, 0.0, 0.0]), Outcome.OFF_ROAD),
    ]
    found = evaluate(rows, PAPER, with_optimum=False)
    assert found["mean_peak_yaw_acceleration"] == pytest.approx(0.2)
    assert found["max_peak_yaw_acceleration"] == pytest.approx(0.3)
    assert found["cost_ratio"] is None
    assert found["mean_optimal_return"] is None


def test_turned_back_and_missed_counts_once():
    rows = [
        maneuver(trace(0), outcome, num_aborts=num_aborts)
        for outcome in (Outcome.COMPLETED, Outcome.MISSED, Outcome.COLLISION, Outcome.HORIZON)
        for num_aborts in (0, 3)
    ]
    found = evaluate(rows, PAPER, with_optimum=False)
    assert (found["abort_rate"], found["missed_rate"]) == (0.5, 0.25)
    assert found["abort_or_miss_rate"] == 0.625


def test_every_mean_is_that_of_its_contributions():
    measures = [measure(one, PAPER, with_optimum=False) for one in sample()]
    found = summarise(measures)
    for key, contribution in AVERAGES.items():
        values = [value for value in map(contribution, measures) if math.isfinite(value)]
        assert found[key] == (np.mean(values) if values else None), key
        if not key.startswith("mean_"):
            assert set(values) <= {0.0, 1.0}, key


def test_what_no_maneuver_defines_is_none():
    found = evaluate([maneuver(trace(0))], PAPER)
    undefined = {name for name, value in found.items() if value is None}
    assert {"mean_return", "cost_ratio", "min_time_to_collision", "mean_duration"} < undefined
    assert found["mean_return_all"] == 0.0
    assert found["mean_waiting_time"] == 1.5
    for maneuvers in ([maneuver(trace(0))], sample()):
        text = json.dumps(evaluate(maneuvers, PAPER), allow_nan=False)
        assert set(json.loads(text)) == set(found)


def test_progress_counts_the_maneuvers():
    counts = []
    evaluate(sample(), PAPER, with_optimum=False, progress=counts.append)
    assert counts == [1, 2, 3, 4]
    assert summarise([measure(one, PAPER, with_optimum=False) for one in sample()]) == evaluate(
        sample(), PAPER, with_optimum=False
    )
