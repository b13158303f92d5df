from itertools import pairwise

import numpy as np
import pytest

from marl_lanes.evaluation.aftermath import WATCHED_TIME
from marl_lanes.evaluation.policies import make_tuned_cascade_policy
from marl_lanes.evaluation.recording import RoadRecorder, record_maneuvers, record_road
from marl_lanes.evaluation.rollout import run_maneuvers
from marl_lanes.scenario import ScenarioError, load_scenario
from marl_lanes.traffic.machine.state import Outcome
from marl_lanes.traffic.simulator import Simulator
from marl_lanes.trajectory.events import find_commands
from marl_lanes.trajectory.file import read_trajectory

SCENARIO = load_scenario("paper", {"num_agents": 2})
POLICY = make_tuned_cascade_policy(SCENARIO)
ENDLESS = load_scenario("paper", {"num_agents": None, "horizon": None})


@pytest.fixture(scope="module")
def evaluated(tmp_path_factory):
    """Maneuvers of three roads, recorded on the way."""
    path = tmp_path_factory.mktemp("recorded") / "roads.parquet"
    maneuvers = record_maneuvers(path, "tuned-cascade", SCENARIO, POLICY, 5, seed=5)
    return maneuvers, read_trajectory(path)


def test_an_evaluation_is_the_same_with_and_without_recording(evaluated):
    maneuvers, _ = evaluated
    plain = run_maneuvers(SCENARIO, POLICY, 5, seed=5)
    assert len(plain) == len(maneuvers) == 5
    for one, other in zip(plain, maneuvers, strict=True):
        assert one.trace.tobytes() == other.trace.tobytes()
        assert one.outcome == other.outcome


def test_the_recording_of_an_evaluation_has_its_roads_and_maneuvers(evaluated):
    maneuvers, trajectory = evaluated
    assert trajectory.roads == [0, 1, 2]
    for maneuver in maneuvers:
        commands = find_commands(trajectory.rows_of(maneuver.env))
        command = next(one for one in commands if one.command == maneuver.command)
        assert command.outcome == maneuver.outcome == Outcome.COMPLETED
        assert command.engaged_steps[0] == maneuver.trace["step"][0] - 1
        rows = trajectory.rows_of(maneuver.env)
        steered = rows[np.isfinite(rows["action_yaw_acceleration"])]
        own = steered[steered["command"] == maneuver.command]
        np.testing.assert_array_equal(own["step"], maneuver.trace["step"])


def test_every_road_is_recorded_until_its_last_vehicles_have_settled(evaluated):
    maneuvers, trajectory = evaluated
    watched = round(WATCHED_TIME / SCENARIO.time_step)
    for road in (0, 1):
        ends = [one.trace["step"][-1] for one in maneuvers if one.env == road]
        steps = np.unique(trajectory.rows_of(road)["step"])
        assert steps[0] == 0
        assert steps[-1] == max(ends) + watched
        assert all(after == before + 1 for before, after in pairwise(steps.tolist()))


def test_one_road_by_itself_is_the_road_of_the_evaluation(evaluated):
    _, trajectory = evaluated
    alone = record_road(SCENARIO, POLICY, seed=5, name="tuned-cascade", road=1)
    assert alone.metadata == trajectory.metadata
    assert alone.rows.tobytes() == trajectory.rows_of(1).tobytes()


def test_a_part_of_the_roads():
    simulator = Simulator(SCENARIO, 3, seed=5)
    simulator.reset()
    blocks = []
    recorder = RoadRecorder(simulator, blocks.append, [2, 0])
    simulator.step()
    recorder.advance()
    assert [np.unique(block["road"]).tolist() for block in blocks] == [[0, 2], [0, 2]]
    assert not recorder.is_over


@pytest.mark.parametrize(("last_time", "last_step"), [(2.5, 25), (2.41, 25), (0.05, 1)])
def test_a_recording_ends_at_its_last_time(last_time, last_step):
    found = record_road(ENDLESS, POLICY, name="tuned-cascade", last_time=last_time)
    assert np.unique(found.rows["step"]).tolist() == list(range(last_step + 1))


def test_a_scenario_without_end_needs_a_last_time():
    with pytest.raises(ScenarioError, match="episodes have no end"):
        record_road(ENDLESS, POLICY, name="tuned-cascade")


@pytest.mark.parametrize("last_time", [0.0, -1.0, float("nan"), float("inf")])
def test_a_last_time_that_cannot_be(last_time):
    with pytest.raises(ValueError, match="last_time"):
        record_road(ENDLESS, POLICY, name="tuned-cascade", last_time=last_time)
