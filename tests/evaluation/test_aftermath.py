"""Completed vehicles afterwards: staged by hand, and with policies that settle or do not."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from marl_lanes import load_scenario
from marl_lanes.evaluation.aftermath import Aftermath, Watch
from marl_lanes.evaluation.metrics import evaluate
from marl_lanes.evaluation.rollout import TRACE, Maneuver, run_maneuvers
from marl_lanes.naf.checkpoint import greedy_policy
from marl_lanes.traffic.machine.state import AGENT, ROAD, VEHICLE, Fate, Outcome, structure
from marl_lanes.training.checkpoint import make_network

torch.set_num_threads(1)
TOUCH = {"max_deviation": 0.2, "max_lateral_speed": None, "max_yaw_rate": None}
SETTLED = {"max_deviation": 0.2, "max_lateral_speed": 0.25, "max_yaw_rate": 0.03}
# Many roads with a few commands each take fewer steps than a few with ten.
SHORT = {"num_agents": 3, "command": {"probability": 1.0}}
FIVE = load_scenario("five_lanes", SHORT | {"completion": TOUCH})


class Stage:
    """One road of five lanes with cars at given places, and a watch of the first one."""

    def __init__(self, *, lane=2, direction=1, lanes=None, speed=20.0, yaw=0.0, fate=Fate.STAYS):
        self.simulator = SimpleNamespace(
            scenario=FIVE,
            vehicles=np.zeros((1, 3), structure(VEHICLE)),
            agents=np.zeros((1, 2), structure(AGENT)),
            roads=np.zeros(1, structure(ROAD)),
        )
        self.car = self.simulator.vehicles[0, 1]
        self.car["id"], self.car["speed"], self.car["yaw"] = 7, speed, yaw
        self.car["fate"] = fate
        agent = self.simulator.agents[0, 1]
        agent["vehicle"], agent["target_lane"], agent["direction"] = 1, lane, direction
        self.put(0.0, lane, lanes)
        if fate != Fate.STAYS:
            self.car["id"] = -1
        self.watch = Watch(self.simulator)
        (self.found,) = self.watch.begin(np.array([0]), np.array([1]))

    def put(self, deviation, lane, lanes=None):
        """``deviation`` [m] from the centre of ``lane``, the body in ``lanes``."""
        self.car["lane"] = lane
        self.car["lateral_position"] = (lane + 0.5) * 3.75 + deviation
        self.car["lane_low"], self.car["lane_high"] = lanes or (lane, lane)

    def step(self, deviation=0.0, lane=2, lanes=None, fate=Fate.STAYS):
        self.put(deviation, lane, lanes)
        if fate != Fate.STAYS:
            self.car["fate"], self.car["id"] = fate, -1
        self.simulator.roads["step"] += 1
        self.watch.advance()

    def finish(self):
        while not self.watch.is_over:
            self.step()
        self.watch.finish()
        return self.found


def test_a_quiet_vehicle_is_watched_for_ten_seconds():
    stage = Stage(speed=25.0, yaw=-0.01, direction=-1)
    for _ in range(99):
        stage.step(0.1)
    assert not stage.watch.is_over
    stage.step(0.1)
    assert stage.watch.is_over
    found = stage.finish()
    assert (found.fate, found.is_good, found.has_left_lane) == (Fate.STAYS, True, False)
    assert found.watched_time == pytest.approx(10.0)
    # A change to the right: left of the centre the deviation is negative.
    assert found.deviation == pytest.approx([0.0, *[-0.1] * 100])
    assert found.lateral_speed == pytest.approx(25.0 * math.sin(0.01))
    assert found.peak_deviation == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("fate", "is_lost", "has_collided", "is_good"),
    [
        (Fate.STRAYS, True, False, False),
        (Fate.COLLIDES, False, True, False),
        (Fate.LEAVES, False, False, True),
    ],
)
def test_how_a_watch_can_end(fate, is_lost, has_collided, is_good):
    stage = Stage()
    stage.step(0.05)
    stage.step(0.1, fate=fate)
    assert stage.watch.is_over
    # Another vehicle takes the slot; the watch ignores it.
    stage.car["id"], stage.car["fate"] = 8, Fate.STAYS
    stage.step(1.5, lanes=(1, 2))
    found = stage.finish()
    assert (found.is_lost, found.has_collided, found.is_good) == (is_lost, has_collided, is_good)
    assert found.has_left_lane == is_lost
    assert found.watched_time == pytest.approx(0.2)
    assert found.deviation == pytest.approx([0.0, 0.05, 0.1])


def test_completion_at_the_roads_end_is_all_there_is_to_see():
    stage = Stage(fate=Fate.LEAVES)
    assert stage.watch.is_over
    found = stage.finish()
    assert (found.fate, found.is_good, found.watched_time) == (Fate.LEAVES, True, 0.0)


def test_a_body_in_another_lane_has_left_its_own():
    for lanes in ((1, 2), (2, 3)):
        stage = Stage()
        stage.step(1.2, lanes=lanes)
        assert stage.finish().has_left_lane
        assert not stage.found.is_good


def test_a_body_still_in_the_old_lane_may_leave_it_once():
    stage = Stage(lanes=(1, 2))
    stage.step(-1.2, lanes=(1, 2))
    stage.step(-0.5)
    stage.step(-0.5)
    assert not stage.finish().has_left_lane
    stage = Stage(lanes=(1, 2))
    stage.step(-0.5)
    stage.step(-1.2, lanes=(1, 2))
    assert stage.finish().has_left_lane
    stage = Stage(lanes=(1, 2))
    stage.step(1.2, lanes=(2, 3))
    assert stage.finish().has_left_lane


@pytest.mark.parametrize(("lane", "away"), [(3, 1.0), (1, -1.0)])
def test_lane_keeping_may_be_told_another_lane(lane, away):
    both = (min(2, lane), max(2, lane))
    stage = Stage()
    stage.step(0.1)
    stage.step(-3.65 * away, lane=lane, lanes=(2, 2))
    stage.step(-2.0 * away, lane=lane, lanes=both)
    stage.step(-0.5 * away, lane=lane)
    for _ in range(96):
        stage.step(0.0, lane=lane)
    found = stage.finish()
    assert found.is_good
    assert found.watched_time == pytest.approx(10.0)
    # The deviations end when lane keeping gets another lane.
    assert found.deviation == pytest.approx([0.0, 0.1])
    # A lane on the other side is not allowed.
    stage = Stage()
    stage.step(-3.65 * away, lane=lane, lanes=(2, 2))
    stage.step(-5.0 * away, lane=lane, lanes=(min(2, 4 - lane), max(2, 4 - lane)))
    stage.step(0.0, lane=lane)
    stage.step(0.0, lane=lane, fate=Fate.LEAVES)
    assert stage.finish().has_left_lane


@pytest.mark.parametrize(
    ("deviation", "time"),
    [
        ([0.2, 0.1, -0.2], 0.0),
        ([0.3, 0.1, 0.0], 0.1),
        ([0.1, 0.3, 0.1, -0.25, 0.1, 0.0], 0.4),
        ([0.1, 0.1, 0.3], math.nan),
    ],
)
def test_the_time_until_it_has_settled(deviation, time):
    found = Aftermath(0.0, deviation=np.asarray(deviation))
    assert found.settling_time(0.1) == pytest.approx(time, nan_ok=True)
    assert found.peak_deviation == max(map(abs, deviation))
    lost = Aftermath(0.0, Fate.STRAYS, deviation=np.asarray(deviation))
    assert math.isnan(lost.settling_time(0.1))


def test_several_vehicles_are_told_apart():
    stage = Stage()
    other = stage.simulator.vehicles[0, 2]
    other["id"], other["lane"], other["lateral_position"] = 9, 1, 5.625
    other["lane_low"] = other["lane_high"] = 1
    agent = stage.simulator.agents[0, 0]
    agent["vehicle"], agent["target_lane"], agent["direction"] = 2, 1, -1
    for _ in range(40):
        stage.step(0.1)
    (late,) = stage.watch.begin(np.array([0]), np.array([0]))
    for _ in range(60):
        other["lateral_position"] += 0.001
        stage.step(0.1)
    other["fate"], other["id"] = Fate.COLLIDES, -1
    first = stage.finish()
    assert (len(first.deviation), first.is_good) == (101, True)
    assert (len(late.deviation), late.has_collided) == (62, True)
    assert late.deviation[:3] == pytest.approx([0.0, -0.001, -0.002])
    assert late.watched_time == pytest.approx(6.1)


def test_nobody_has_completed_without_an_aftermath():
    rows = np.zeros(0, TRACE)
    with pytest.raises(ValueError, match="aftermath = None: must be given"):
        Maneuver(0, 0, 7, Outcome.COMPLETED, 0, 0, 0.0, 1.0, False, -2.0, rows)
    with pytest.raises(ValueError, match="is MISSED"):
        Maneuver(0, 0, 7, Outcome.MISSED, 0, 0, 0.0, 1.0, False, -2.0, rows, Aftermath(0.0))


def dive(observations):
    """Hold eight degrees of yaw toward the lane and beyond it."""
    _, _, deviation, yaw, yaw_rate, _ = observations.astype(np.float64).T
    action = 20.0 * (0.14 * np.sign(deviation) - yaw) - 8.0 * yaw_rate
    return np.clip(action, -0.5, 0.5)[:, None]


def test_who_dives_through_the_lane_completes_and_does_not_succeed():
    scenario = load_scenario("paper", SHORT | {"completion": TOUCH})
    maneuvers = run_maneuvers(scenario, dive, 60, seed=0)
    found = evaluate(maneuvers, scenario, with_optimum=False)
    assert found["completion_rate"] == 1.0
    assert found["success_rate"] == found["success_of_completed_rate"] == 0.0
    assert found["lost_after_rate"] > 0.9
    assert found["left_lane_after_rate"] == found["unsettled_after_rate"] == 1.0
    assert found["mean_lateral_speed_at_completion"] > 2.0
    assert found["mean_watched_time"] < 2.0


def test_beyond_the_lane_there_may_be_another_one():
    """On five lanes some vehicles leave their lane, but not the road."""
    scenario = load_scenario(FIVE, {"departures": {"interval": [2.0, 4.0]}, "max_vehicles": 192})
    maneuvers = run_maneuvers(scenario, dive, 100, seed=0)
    found = evaluate(maneuvers, scenario, with_optimum=False)
    assert found["completion_rate"] > 0.9
    assert found["success_rate"] == 0.0
    assert found["left_lane_after_rate"] == 1.0
    assert 0.0 < found["lost_after_rate"] < 1.0


def test_who_settles_succeeds():
    scenario = load_scenario("paper", SHORT | {"completion": SETTLED})
    torch.manual_seed(0)
    policy = greedy_policy(make_network(scenario, "damped"))
    found = evaluate(run_maneuvers(scenario, policy, 60, seed=0), scenario, with_optimum=False)
    assert found["success_rate"] == found["completion_rate"] > 0.95
    assert found["success_of_completed_rate"] == 1.0
    assert found["left_lane_after_rate"] == found["unsettled_after_rate"] == 0.0
    assert found["max_lateral_speed_at_completion"] <= 0.25
    assert found["max_peak_deviation_after"] < 0.5


def test_the_watch_goes_on_when_the_episode_is_over():
    """On all roads, also on those whose episode ends first or at the horizon."""
    scenario = load_scenario("paper", {"completion": SETTLED, "num_agents": 3, "horizon": 45.0})
    torch.manual_seed(0)
    policy = greedy_policy(make_network(scenario, "damped"))
    maneuvers = run_maneuvers(scenario, policy, 60, seed=1)
    watched = [one for one in maneuvers if one.aftermath is not None]
    late = [one for one in watched if one.born_step * 0.1 + one.time_to_end > 36.0]
    assert len(watched) > 20
    assert len(late) > 3
    for one in watched:
        found = one.aftermath
        is_whole = found.watched_time == pytest.approx(10.0)
        assert is_whole == (found.fate == Fate.STAYS)
        assert found.fate in {Fate.STAYS, Fate.LEAVES}
        assert len(found.deviation) == round(found.watched_time / 0.1) + 1
    assert any(one.aftermath.fate == Fate.STAYS for one in late)
