"""The optimum of a recorded maneuver is that of the metrics."""

import numpy as np
import pytest
from recordings import record

from marl_lanes.browser.optima import find_optima
from marl_lanes.evaluation.measures import measure
from marl_lanes.evaluation.policies import make_tuned_cascade_policy
from marl_lanes.evaluation.rollout import run_maneuvers
from marl_lanes.trajectory.events import find_commands

pytestmark = pytest.mark.slow

NUM_STEPS = 420


@pytest.fixture(scope="module", params=["interactive", "curved"])
def driven(request):
    """A recorded road, and its maneuvers as an evaluation sees them."""
    trajectory = record(request.param, NUM_STEPS)
    scenario = trajectory.scenario
    maneuvers = run_maneuvers(scenario, make_tuned_cascade_policy(scenario), 10, seed=0)
    return trajectory, maneuvers


def test_costs_are_those_of_the_metrics(driven):
    trajectory, maneuvers = driven
    optima = find_optima(trajectory.rows_of(0), trajectory.scenario)
    compared = 0
    for command in find_commands(trajectory.rows_of(0)):
        found = optima[command.command]
        if "reason" in found:
            continue
        (maneuver,) = (one for one in maneuvers if one.command == command.command)
        metrics = measure(maneuver, trajectory.scenario)
        # The rows hold single precision.
        assert found["cost"] == pytest.approx(-metrics.optimal_return, rel=1e-4)
        assert found["total_cost"] == pytest.approx(-metrics.return_, rel=1e-4)
        assert found["driven_cost"] <= found["total_cost"]
        assert (found["driven_cost"] < found["total_cost"]) == (command.num_aborts > 0)
        compared += 1
    assert compared >= 2


def test_the_path_begins_where_the_maneuver_does_and_ends_in_the_target_lane(driven):
    trajectory, _ = driven
    scenario, rows = trajectory.scenario, trajectory.rows_of(0)
    optima = find_optima(rows, scenario)
    for command in find_commands(rows):
        found = optima[command.command]
        if "reason" in found:
            continue
        assert found["first_step"] == command.engaged_steps[-1]
        is_first = (rows["step"] == found["first_step"]) & (rows["vehicle"] == command.vehicle)
        (first,) = rows[is_first]
        for name, decimals in (("position", 3), ("lateral_position", 4), ("yaw", 6)):
            assert found[name][0] == pytest.approx(float(first[name]), abs=10.0**-decimals)
        centre = (first["target_lane"] + 0.5) * scenario.road.lane_width
        limit = scenario.completion.max_deviation + 1e-3
        assert abs(found["lateral_position"][-1] - centre) <= limit
        assert len({len(found[name]) for name in ("position", "yaw", "yaw_acceleration")}) == 1
        # The path has the cost that is claimed.
        weight = scenario.reward.yaw_acceleration_weight
        actions = weight * np.abs(found["yaw_acceleration"][1:]).sum()
        assert 0.0 < actions < found["cost"]


def test_why_there_is_none(driven):
    trajectory, _ = driven
    rows, scenario = trajectory.rows_of(0), trajectory.scenario
    unfinished = [one for one in find_commands(rows) if one.outcome.name != "COMPLETED"]
    optima = find_optima(rows, scenario)
    for command in unfinished:
        assert optima[command.command] == {"reason": "the change was not completed"}
    complete = next(one for one in find_commands(rows) if one.outcome.name == "COMPLETED")
    late = rows[rows["step"] > complete.engaged_steps[-1]]
    reason = find_optima(late, scenario)[complete.command]["reason"]
    assert reason == "the change began before the recording"


def test_an_optimum_of_another_cost_is_not_shown(driven, monkeypatch):
    trajectory, _ = driven
    monkeypatch.setattr("marl_lanes.evaluation.optimum.MINIMISED", ("yaw_acceleration", "yaw_rate"))
    found = find_optima(trajectory.rows_of(0), trajectory.scenario)
    reason = "the reward has costs that no optimum minimizes: deviation"
    assert list(found.values()) == [{"reason": reason}] * len(found)
    assert found


def test_progress_counts_the_maneuvers(driven):
    trajectory, _ = driven
    rows, counted = trajectory.rows_of(0), []
    find_optima(rows, trajectory.scenario, progress=counted.append)
    assert counted == list(range(1, len(find_commands(rows)) + 1))


def test_a_recording_that_cannot_be_has_a_reason(driven):
    """An optimum that does not exist is said, and stops nothing."""
    trajectory, _ = driven
    rows = trajectory.rows_of(0).copy()
    rows["speed"] = -1.0
    reasons = [one.get("reason") for one in find_optima(rows, trajectory.scenario).values()]
    assert any(one is not None and one.startswith("none was found: speed[0] is") for one in reasons)
