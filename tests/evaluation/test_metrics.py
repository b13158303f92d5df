"""Every metric against values worked out by hand from small traces."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from traces import maneuver, trace

from marl_lanes import load_scenario
from marl_lanes.evaluation import optimum
from marl_lanes.evaluation.aftermath import Aftermath
from marl_lanes.evaluation.measures import measure
from marl_lanes.evaluation.metrics import AVERAGES, HARD_BRAKING, evaluate, summarise
from marl_lanes.evaluation.optimum import find_unminimised
from marl_lanes.traffic.machine.state import Fate, Outcome
from marl_lanes.traffic.roles.changer import CHANGER

TOUCH = {"max_deviation": 0.2, "max_lateral_speed": None, "max_yaw_rate": None}
PAPER = load_scenario("paper", {"completion": TOUCH})


def sample():
    """One completed maneuver, one that collided, one that never engaged."""
    completed = trace(
        30,
        reward_yaw_acceleration=-0.1,
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
        maneuver(completed, Outcome.COMPLETED, num_aborts=2),
        maneuver(collided, Outcome.COLLISION, has_side_collision=True, num_aborts=1),
        maneuver(trace(0), Outcome.MISSED, waiting_time=6.0, episode_reward=-0.5),
        maneuver(trace(2), Outcome.OFF_ROAD, waiting_time=0.0),
    ]


def test_the_summary_counts_and_averages():
    found = evaluate(sample(), PAPER)
    assert found["num_maneuvers"] == 4
    for name in ("success", "completion", "collision", "steering_collision", "missed", "off_road"):
        assert found[f"{name}_rate"] == 0.25, name
    assert found["horizon_rate"] == 0.0
    assert found["abort_rate"] == 0.5
    assert found["mean_num_aborts"] == 0.75
    # Two aborted, another one missed.
    assert found["abort_or_miss_rate"] == 0.75
    assert found["mean_episode_reward"] == -3.5
    assert found["mean_return"] == pytest.approx(-3.6)
    assert found["mean_return_yaw_acceleration"] == pytest.approx(-3.0)
    assert found["mean_return_yaw_rate"] == pytest.approx(-0.6)
    assert found["mean_return_deviation"] == 0.0
    assert found["mean_return_all"] == pytest.approx((-3.6 - 1.0) / 4)
    assert found["mean_optimal_return"] == pytest.approx(-3.33, rel=0.01)
    assert found["cost_ratio"] == pytest.approx(-3.6 / found["mean_optimal_return"])
    assert found["mean_num_steps"] == 30
    assert found["mean_duration"] == pytest.approx(3.0)
    assert found["mean_waiting_time"] == pytest.approx((1.5 + 1.5 + 6.0) / 4)
    assert found["mean_time_to_completion"] == 9.0
    assert found["mean_max_follower_braking"] == found["max_follower_braking"] == 0.5
    assert found["mean_max_changer_braking"] == found["max_changer_braking"] == 0.25
    # Over all maneuvers with a follower: the completed one and the one that collided.
    assert found["mean_max_follower_braking_all"] == 1.0
    assert found["max_follower_braking_all"] == 1.5
    assert found["min_time_to_collision"] == pytest.approx(2.0)
    assert found["median_min_time_to_collision"] == pytest.approx(2.0)
    assert found["critical_time_to_collision_rate"] == 0.0
    assert found["s_critical_violation_rate"] is None


def test_success_is_what_lasts():
    """Eight maneuvers; of four completed ones one is lost, one collides, one leaves its lane."""
    bad = Aftermath(2.5, Fate.STRAYS, has_left_lane=True, watched_time=0.5)
    hit = Aftermath(0.5, Fate.COLLIDES, watched_time=1.5)
    away = Aftermath(0.5, has_left_lane=True, watched_time=10.0)
    good = Aftermath(0.5, Fate.LEAVES, watched_time=8.0)
    rows = [maneuver(trace(1), Outcome.COMPLETED, aftermath=one) for one in (bad, hit, away, good)]
    rows += [maneuver(trace(0))] * 4
    found = evaluate(rows, PAPER, with_optimum=False)
    assert list(found)[:4] == ["num_maneuvers", "success_rate", "completion_rate", "cost_ratio"]
    assert (found["success_rate"], found["completion_rate"]) == (0.125, 0.5)
    assert found["success_of_completed_rate"] == 0.25
    assert found["lost_after_rate"] == found["collided_after_rate"] == 0.25
    assert found["left_lane_after_rate"] == found["unsettled_after_rate"] == 0.5
    assert found["mean_watched_time"] == 5.0
    assert found["mean_lateral_speed_at_completion"] == 1.0
    assert found["max_lateral_speed_at_completion"] == 2.5
    missed = evaluate(rows[4:], PAPER, with_optimum=False)
    assert missed["success_rate"] == 0.0
    assert missed["success_of_completed_rate"] is None


def test_shares_of_hard_braking():
    """Over the completed maneuvers: which vehicle brakes, how hard, before or after the marking."""
    over = [False, True, True]

    def one(outcome=Outcome.COMPLETED, **columns):
        return maneuver(trace(3, is_over_marking=over, **columns), outcome)

    rows = [
        one(acceleration=[-2.5, 0.0, -1.0]),
        # At the limit, up to rounding of the speed.
        one(acceleration=[0.0, 0.0, -7.9999999], follower_acceleration=[-4.5, 0.0, 0.0]),
        one(follower_acceleration=[0.0, -1.0, -2.0]),
        one(),
        one(Outcome.COLLISION, acceleration=-8.0),
    ]
    found = evaluate(rows, PAPER, with_optimum=False)

    def shares(prefix):
        return [found[f"{prefix.format(limit)}_rate"] for limit in HARD_BRAKING]

    assert HARD_BRAKING == (2, 4, 8)
    assert shares("braking_reaches_{}") == [0.75, 0.25, 0.25]
    assert shares("changer_braking_reaches_{}_before_marking") == [0.25, 0.0, 0.0]
    assert shares("changer_braking_reaches_{}_after_marking") == [0.25, 0.25, 0.25]
    assert shares("follower_braking_reaches_{}_before_marking") == [0.25, 0.25, 0.0]
    assert shares("follower_braking_reaches_{}_after_marking") == [0.25, 0.0, 0.0]


def test_safety_is_of_all_maneuvers():
    rows = [
        maneuver(trace(2, follower_gap=10.0, follower_speed=25.0, imposed_on_follower=1.0)),
        maneuver(trace(2, follower_gap=2.5, follower_speed=25.0, imposed_on_follower=3.0)),
        maneuver(trace(2)),
        maneuver(trace(0)),
    ]
    found = evaluate(rows, PAPER, with_optimum=False)
    assert found["mean_imposed_on_follower"] == 2.0
    assert found["max_imposed_on_follower"] == 3.0
    assert found["mean_drac"] == pytest.approx((1.25 + 5.0) / 3.0)
    assert found["max_drac"] == pytest.approx(5.0)
    assert found["mean_time_exposed"] == pytest.approx(0.2 / 3.0)
    assert found["critical_time_to_collision_rate"] == pytest.approx(1.0 / 3.0)
    assert found["min_time_to_collision"] == 0.5
    assert found["min_time_to_collision_target_follower"] == 0.5
    assert found["min_time_to_collision_target_leader"] is None
    assert found["median_min_time_to_collision"] == pytest.approx(1.25)


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
    measures = [measure(one, PAPER, with_optimum=False) for one in sample()]
    no_optimum = "the optimum was not computed"
    assert summarise(measures, no_optimum=no_optimum) == evaluate(
        sample(), PAPER, with_optimum=False
    )


def test_no_cost_ratio_without_a_reason(monkeypatch):
    """With a steering cost that the optimum does not minimise it would compare different costs."""
    delay = next(term for term in CHANGER.terms if term.name == "delay")
    terms = (*CHANGER.terms, delay._replace(name="jerk", is_steering_cost=True))
    charged = load_scenario("paper", {"reward": {"delay_weight": 0.1}})
    assert find_unminimised(charged) == []
    monkeypatch.setattr(optimum, "CHANGER", replace(CHANGER, terms=terms))
    assert find_unminimised(PAPER) == []
    assert find_unminimised(charged) == ["jerk"]
    found = evaluate(sample(), charged)
    assert found["cost_ratio"] is found["mean_optimal_return"] is None
    assert found["no_cost_ratio"] == "the optimum does not minimise jerk"
    skipped = evaluate(sample(), PAPER, with_optimum=False)
    assert skipped["no_cost_ratio"] == "the optimum was not computed"
    assert evaluate([maneuver(trace(0))], PAPER)["no_cost_ratio"] == "no maneuver was completed"
    assert evaluate(sample(), PAPER)["no_cost_ratio"] is None
