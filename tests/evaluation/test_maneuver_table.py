"""The table of maneuvers: what went wrong in words, the times, the file."""

import csv

import numpy as np
import pytest
from traces import maneuver, trace

from marl_lanes import load_scenario
from marl_lanes.evaluation.aftermath import Aftermath
from marl_lanes.evaluation.maneuver_table import (
    Row,
    explain_failure,
    tabulate,
    write_maneuvers,
)
from marl_lanes.evaluation.metrics import measure_each
from marl_lanes.evaluation.rollout import run_maneuvers
from marl_lanes.traffic.machine.state import Fate, Outcome, Phase

PAPER = load_scenario("paper")


def after(fate=Fate.STAYS, watched_time=2.25, *, has_left_lane=False):
    return Aftermath(0.1, fate=fate, watched_time=watched_time, has_left_lane=has_left_lane)


def driven(outcome, *, last_step=90, phase=Phase.ENGAGED, num_rows=4, **changes):
    """A command of 90 steps; its last row is of ``last_step``."""
    rows = trace(num_rows, phase=phase)
    rows["step"] = last_step + 1 - num_rows + np.arange(num_rows)
    return maneuver(rows, outcome, time_to_end=9.0, **changes)


@pytest.mark.parametrize(
    ("one", "words"),
    [
        (driven(Outcome.COMPLETED, aftermath=after(Fate.STAYS)), ""),
        (driven(Outcome.COMPLETED, aftermath=after(Fate.LEAVES)), ""),
        (
            driven(Outcome.COMPLETED, aftermath=after(Fate.STRAYS, has_left_lane=True)),
            "lost 2.2 s after completion: left the road, or stood across it",
        ),
        (
            driven(Outcome.COMPLETED, aftermath=after(Fate.COLLIDES, has_left_lane=True)),
            "collided 2.2 s after completion",
        ),
        (
            driven(Outcome.COMPLETED, aftermath=after(has_left_lane=True)),
            "got out of its lane after completion",
        ),
        (
            driven(Outcome.MISSED, num_rows=0),
            "reached the end of the road while waiting for a gap, which never came",
        ),
        (
            driven(Outcome.MISSED, last_step=89, num_aborts=1),
            "reached the end of the road while waiting for a gap after 1 abort",
        ),
        (
            driven(Outcome.MISSED, num_aborts=3),
            "reached the end of the road while changing lanes after 3 aborts",
        ),
        (
            driven(Outcome.COLLISION, phase=Phase.ABORTING, num_aborts=1),
            "collided while returning to its lane",
        ),
        (
            driven(Outcome.COLLISION, has_side_collision=True),
            "collided while changing lanes, side by side",
        ),
        (
            driven(Outcome.OFF_ROAD),
            "left the road, or stood across it, while changing lanes",
        ),
        (
            driven(Outcome.TIMED_OUT, num_aborts=1),
            "ran out of time while changing lanes after 1 abort",
        ),
        (
            driven(Outcome.HORIZON, last_step=50),
            "cut off by the end of the episode while waiting for a gap",
        ),
    ],
)
def test_what_went_wrong(one, words):
    assert explain_failure(one, 0.1) == words


def test_the_times_and_costs():
    ones = [
        driven(Outcome.COMPLETED, born_step=20, aftermath=after(Fate.STRAYS), env=3, command=2),
        driven(Outcome.COMPLETED, born_step=20, aftermath=after(has_left_lane=True)),
        driven(Outcome.MISSED, born_step=20, num_aborts=2),
    ]
    measured, _ = measure_each(ones, PAPER)
    lost, out, missed = tabulate(ones, measured, PAPER)
    assert (lost.road, lost.command, lost.vehicle, lost.is_success) == (3, 2, 7, 0)
    assert (lost.command_time, lost.end_time) == (2.0, 11.0)
    assert lost.failure_time == pytest.approx(13.25)
    assert np.isnan(out.failure_time)
    assert missed.failure_time == 11.0
    assert (missed.outcome, missed.num_aborts, missed.num_steps) == ("missed", 2, 4)
    assert np.isnan(missed.cost_ratio)
    assert lost.cost_ratio == pytest.approx(lost.return_ / lost.optimal_return)


def test_the_file(tmp_path):
    ones = [driven(Outcome.COMPLETED), driven(Outcome.MISSED, born_step=3)]
    measured, _ = measure_each(ones, PAPER, with_optimum=False)
    write_maneuvers(tmp_path / "a.csv", tabulate(ones, measured, PAPER))
    with (tmp_path / "a.csv").open(newline="", encoding="utf-8") as file:
        good, bad = csv.DictReader(file)
    assert list(good) == [name.removesuffix("_") for name in Row._fields]
    assert (good["is_success"], good["failure"], good["failure_time"]) == ("1", "", "")
    # 3 * 0.1 s is not written with its rounding error.
    assert (bad["command_time"], bad["end_time"]) == ("0.3", "9.3")
    assert (bad["optimal_return"], bad["is_success"]) == ("", "0")


@pytest.mark.slow
def test_a_row_says_whether_it_is_a_success_and_why_not():
    """On real traffic, with a policy that drives off the road."""
    scenario = load_scenario("paper", {"num_agents": 4})

    def swerve(observations):
        return np.full((len(observations), 1), 0.05)

    ones = run_maneuvers(scenario, swerve, 8, seed=1)
    measured, _ = measure_each(ones, scenario, with_optimum=False)
    rows = tabulate(ones, measured, scenario)
    assert {row.is_success for row in rows} == {0}
    assert all(row.failure for row in rows)
    # Vehicles are numbered as they enter, and no two are the same.
    assert len({(row.road, row.vehicle) for row in rows}) == 8
    assert all(row.vehicle >= 0 for row in rows)
