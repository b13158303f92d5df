import json
import re
from contextlib import closing

import pytest
import recordings

from marl_lanes import load_scenario
from marl_lanes.evaluation.maneuver_table import tabulate
from marl_lanes.evaluation.metrics import measure_each
from marl_lanes.evaluation.policies import make_random_policy, make_tuned_cascade_policy
from marl_lanes.evaluation.rollout import run_maneuvers
from marl_lanes.report import replays
from marl_lanes.report.replays import RECORDING, replay_failures
from marl_lanes.training.run_folder import RunFolder
from marl_lanes.trajectory.events import find_commands
from marl_lanes.trajectory.file import read_trajectory

pytestmark = pytest.mark.slow


def evaluated(scenario, policy, number):
    maneuvers = run_maneuvers(scenario, policy, number, seed=3)
    return tabulate(maneuvers, measure_each(maneuvers, scenario)[0], scenario)


def header(path):
    (found,) = re.findall(r'id="header">(.*?)</script>', path.read_text(encoding="utf-8"))
    return json.loads(found)


def test_roads_with_failures_have_a_replay(tmp_path, monkeypatch):
    scenario = load_scenario("five_lanes", {**recordings.CROWDED, "num_agents": 4})
    table = evaluated(scenario, recordings.cross, 16)
    failed = sorted({row.road for row in table if not row.is_success})
    assert len(failed) >= 3
    monkeypatch.setattr(replays, "MAX_REPLAYS", 2)
    with closing(RunFolder(tmp_path / "run", ())) as run:
        replay_failures(run, scenario, recordings.cross, table, seed=3)
        files = sorted(path.name for path in (run.path / "replays").iterdir())
        assert files == [f"road_{road:04d}.html" for road in failed[:2]]
        trajectory = read_trajectory(run.trajectory(RECORDING))
        assert trajectory.roads == failed[:2]
        for road, name in zip(failed, files, strict=False):
            assert header(run.path / "replays" / name)["road"] == road
            told = {(row.command, row.vehicle, row.outcome) for row in table if row.road == road}
            seen = {
                (command.command, command.vehicle, command.outcome.name.lower())
                for command in find_commands(trajectory.rows_of(road))
            }
            assert told <= seen


def test_without_a_failure_the_first_road_has_one(tmp_path):
    scenario = load_scenario("paper", {"num_agents": 3})
    policy = make_tuned_cascade_policy(scenario)
    table = evaluated(scenario, policy, 6)
    assert all(row.is_success for row in table)
    with closing(RunFolder(tmp_path / "run", ())) as run:
        replay_failures(run, scenario, policy, table, seed=3)
        assert [path.name for path in (run.path / "replays").iterdir()] == ["road_0000.html"]


def test_a_policy_that_acts_otherwise_the_second_time_is_found(tmp_path):
    scenario = load_scenario("paper", {"num_agents": 3})
    table = evaluated(scenario, make_tuned_cascade_policy(scenario), 6)
    with (
        closing(RunFolder(tmp_path / "run", ())) as run,
        pytest.raises(RuntimeError, match="ended otherwise"),
    ):
        replay_failures(run, scenario, make_random_policy(scenario, 0), table, seed=3)
