"""The row of a policy on a task: what it counts, its intervals, and the time of a decision."""

import time

import numpy as np
import pytest
import torch
from evaluation.test_crossplay import BUSY, changing
from evaluation.test_metrics import PAPER, sample
from traces import maneuver, trace

from marl_lanes.evaluation.aftermath import Aftermath, Fate
from marl_lanes.evaluation.benchmark import (
    ENDINGS,
    MEANS,
    NUM_AGENTS,
    Row,
    Training,
    estimate,
    find_ending,
    measure_row,
    time_decisions,
)
from marl_lanes.evaluation.measures import measure
from marl_lanes.evaluation.metrics import evaluate, measure_each
from marl_lanes.evaluation.policies import make_tuned_cascade_policy
from marl_lanes.evaluation.rollout import run_maneuvers
from marl_lanes.scenario import load_scenario
from marl_lanes.traffic.machine.state import Outcome


def ending(outcome, **after):
    changes = {}
    if outcome == Outcome.COMPLETED:
        changes["aftermath"] = Aftermath(0.125, watched_time=10.0, **after)
    made = maneuver(trace(3), outcome, **changes)
    return find_ending(measure(made, PAPER, with_optimum=False))


@pytest.mark.parametrize(
    ("outcome", "after", "wanted"),
    [
        (Outcome.COMPLETED, {}, "success_rate"),
        (Outcome.COMPLETED, {"has_left_lane": True}, "left_lane_rate"),
        (Outcome.COMPLETED, {"fate": Fate.COLLIDES}, "collided_rate"),
        (Outcome.COMPLETED, {"fate": Fate.COLLIDES, "has_left_lane": True}, "collided_rate"),
        (Outcome.COMPLETED, {"fate": Fate.STRAYS}, "lost_rate"),
        (Outcome.COMPLETED, {"fate": Fate.STRAYS, "has_left_lane": True}, "lost_rate"),
        (Outcome.COLLISION, {}, "collided_rate"),
        (Outcome.OFF_ROAD, {}, "lost_rate"),
        (Outcome.MISSED, {}, "missed_rate"),
        (Outcome.HORIZON, {}, "horizon_rate"),
    ],
)
def test_every_command_ends_in_one_way(outcome, after, wanted):
    assert ending(outcome, **after) == wanted


def test_the_statistics_are_those_of_the_metrics():
    measured, _ = measure_each(sample() * 3, PAPER)
    summary = evaluate(sample() * 3, PAPER)
    found = estimate(measured, [index // 4 for index in range(12)])
    assert list(found) == [*ENDINGS, "cost_ratio", *MEANS]
    for key in ("success_rate", "missed_rate", "cost_ratio", *MEANS):
        wanted = summary[key]
        assert found[key].value == (wanted if wanted is None else pytest.approx(wanted)), key
    assert sum(found[key].value for key in ENDINGS) == pytest.approx(1.0)
    # Roads are drawn, not maneuvers: all roads are the same here.
    success = found["success_rate"]
    assert success.low == success.value == success.high


@pytest.mark.slow
def test_a_row_is_the_evaluation_of_the_same_maneuvers():
    policy, shown = make_tuned_cascade_policy(BUSY), []
    training = Training(scenario="busy", transitions=7, seconds=None, command=None)
    row = measure_row(
        "mine", "busy", BUSY, policy, 20, seed=4, training=training, progress=shown.append
    )
    assert (row.policy, row.task, row.seed, row.training) == ("mine", "busy", 4, training)
    assert (row.num_maneuvers, row.num_roads) == (20, 4)
    summary = evaluate(run_maneuvers(BUSY, policy, 20, seed=4), BUSY)
    for key in ("success_rate", "cost_ratio", "mean_imposed_on_follower"):
        assert row.statistics[key].value == pytest.approx(summary[key])
        assert row.statistics[key].low <= row.statistics[key].value <= row.statistics[key].high
    assert shown == sorted(shown)
    assert shown[-1] == 40
    assert set(row.decision_microseconds) == set(NUM_AGENTS)
    assert all(value > 0.0 for value in row.decision_microseconds.values())
    assert Row.model_validate_json(row.model_dump_json()) == row


def test_a_row_has_no_place_for_commands_that_time_out():
    hasty = load_scenario(BUSY, {"command": {"time_limit": 5.0}})
    match = r"^command.time_limit = 5.0: must be null in a benchmark$"
    with pytest.raises(ValueError, match=match):
        measure_row("none", "busy", hasty, changing, 5)


@pytest.mark.slow
def test_without_a_completed_change_the_row_says_why_there_is_no_ratio():
    row = measure_row("none", "busy", BUSY, lambda seen: np.zeros((len(seen), 1)), 5)
    assert row.no_cost_ratio == "no maneuver was completed"
    assert row.statistics["success_rate"].value == 0.0
    assert row.statistics["cost_ratio"].value is None
    assert measure_row("some", "busy", BUSY, changing, 5).no_cost_ratio is None


def test_a_decision_takes_the_time_of_a_call_over_its_agents():
    calls = []

    def slow(observations):
        calls.append((observations.shape, observations[0, 0], torch.get_num_threads()))
        time.sleep(0.0002)
        return np.zeros((len(observations), 1))

    before = torch.get_num_threads()
    # Of one call there were more agents than are timed together, of the other less.
    seen = [np.full((number, 2), number, np.float32) for number in (64, 3)]
    found = time_decisions(slow, seen)
    assert torch.get_num_threads() == before
    assert {shape for shape, _, _ in calls} == {(1, 2), (64, 2)}
    # In the order of the roads: 200 observations three times, and one before that is not timed.
    first = [value for shape, value, _ in calls if shape == (1, 2)]
    assert len(first) == 1 + 3 * 200
    assert first[0] == 64.0
    assert first[1:201] == sorted(first[1:201], reverse=True)
    assert first[1:201] == first[201:401] == first[401:]
    assert {threads for _, _, threads in calls} == {1}
    assert found[1] > 200.0
    assert 200.0 / 64 < found[64] < found[1] / 8


def test_a_slow_policy_is_timed_for_a_short_time(monkeypatch):
    monkeypatch.setattr("marl_lanes.evaluation.benchmark._MAX_SECONDS", 0.02)
    calls = []

    def slow(observations):
        calls.append(len(observations))
        time.sleep(0.015)
        return np.zeros((len(observations), 1))

    found = time_decisions(slow, [np.zeros((2, 2), np.float32)])
    assert len(calls) <= 2 * (1 + 3 * 2)
    assert found[1] > 15_000.0


def test_the_fastest_of_three_counts_for_each_decision(monkeypatch):
    monkeypatch.setattr("marl_lanes.evaluation.benchmark._MAX_CALLS", 2)
    # Of each size one call that is not timed, and three times an easy one and a hard one.
    costs = iter([9.0, *[1.0, 9.0], *[5.0, 4.0], *[2.0, 5.0]] * len(NUM_AGENTS))
    clock = [0.0]

    def policy(observations):
        clock[0] += next(costs)
        return np.zeros((len(observations), 1))

    monkeypatch.setattr("marl_lanes.evaluation.benchmark.perf_counter", lambda: clock[0])
    monkeypatch.setattr("marl_lanes.evaluation.benchmark._MAX_SECONDS", 100.0)
    found = time_decisions(policy, [np.zeros((2, 2), np.float32)])
    assert found == {1: pytest.approx(2.5e6), 64: pytest.approx(2.5e6 / 64)}
