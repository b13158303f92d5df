"""How a command ends: every outcome, and in which step."""

import numpy as np
import pytest
from staging import command, damped_actions, simulator_of, stage

from marl_lanes.traffic.machine.state import Outcome, Phase
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.traffic.simulator import Simulator

ALWAYS = {"command": {"probability": 1.0}}


@pytest.mark.parametrize("seed", [22, 24, 25])
def test_the_horizon_ends_every_live_agent(seed):
    overrides = {**ALWAYS, "horizon": 3.0, "num_agents": None}
    simulator = Simulator("dense", 16, seed=seed, overrides=overrides)
    simulator.reset()
    for _ in range(29):
        simulator.step()
        assert (simulator.agents["outcome"] != Outcome.HORIZON).all()
    assert (simulator.roads["is_done"] == 0).all()
    was_live = simulator.is_live.copy()
    assert was_live.any()
    simulator.step()
    assert (simulator.roads["is_done"] == 1).all()
    assert (simulator.agents["outcome"][was_live] != Outcome.UNFINISHED).all()
    assert (simulator.agents["outcome"] == Outcome.HORIZON).any()
    assert (simulator.roads["num_live"] == 0).all(), "an agent is live after the episode is over"


def test_an_agent_that_never_finds_a_gap_has_missed_at_the_roads_end():
    overrides = {"gap": {"minimum_gap": 5000.0}, **ALWAYS, "num_agents": 4}
    simulator = Simulator("paper", 1, seed=6, overrides=overrides)
    simulator.reset()
    outcomes = []
    while not simulator.roads["is_done"][0]:
        simulator.step()
        outcomes += simulator.agents["outcome"][simulator.has_ended].tolist()
        assert (simulator.agents["reward"] == 0.0).all()
    assert outcomes == [Outcome.MISSED] * 4


def test_completion_hands_the_car_to_lane_keeping_in_the_target_lane():
    simulator = simulator_of()
    stage(simulator, {"lane": 1, "position": 200.0, "lateral_position": 9.2, "yaw": 0.01})
    agent = command(simulator, 0, 1)
    simulator.step()
    assert simulator.agents[0, agent]["outcome"] == Outcome.COMPLETED
    assert not simulator.is_live.any()
    assert simulator.vehicles[0, 0]["lane"] == 2
    assert simulator.vehicles[0, 0]["agent"] == -1
    for _ in range(100):
        simulator.step(np.full((1, simulator.num_slots, 1), 0.5))
    assert simulator.vehicles[0, 0]["lateral_position"] == pytest.approx(9.375, abs=1e-3)
    assert simulator.agents[0, agent]["vehicle"] == -1


@pytest.mark.parametrize(
    ("values", "has_completed"),
    [({"yaw": 0.0}, True), ({"yaw": 0.02}, False), ({"yaw_rate": 0.04}, False)],
)
def test_a_settled_completion_also_bounds_lateral_speed_and_yaw_rate(values, has_completed):
    completion = {"max_deviation": 0.2, "max_lateral_speed": 0.25, "max_yaw_rate": 0.03}
    simulator = simulator_of(completion=completion)
    stage(simulator, {"lane": 1, "position": 200.0, "lateral_position": 9.3, **values})
    agent = command(simulator, 0, 1)
    simulator.step()
    assert (simulator.agents[0, agent]["outcome"] == Outcome.COMPLETED) == has_completed


@pytest.mark.parametrize("direction", [1, -1])
def test_an_extreme_action_leads_off_the_road_and_is_penalized_once(direction):
    simulator = simulator_of(completion={"max_deviation": 0.01})
    stage(simulator, {"lane": 1, "position": 200.0})
    agent = command(simulator, 0, direction)
    penalties, outcomes = [], []
    for _ in range(60):
        simulator.step(np.full((1, simulator.num_slots, 1), 9.0))
        row = simulator.agents[0, agent]
        penalties.append(float(CHANGER.terms_of(row)["reward_failure"]))
        outcomes.append(int(row["outcome"]))
    assert sorted(set(outcomes)) == [Outcome.UNFINISHED, Outcome.OFF_ROAD]
    assert sum(penalties) == -10.0
    assert penalties.index(-10.0) == outcomes.index(Outcome.OFF_ROAD)
    assert simulator.roads["num_off_road"][0] == simulator.roads["num_left"][0] == 1


TIMED = {"command": {"time_limit": 2.0}}
BESIDE = {"lane": 2, "position": 200.0}
"""A vehicle that makes the target gap unsafe."""


@pytest.mark.parametrize("phase", [Phase.WAITING, Phase.ENGAGED])
def test_a_command_ends_when_its_time_is_over_and_costs_nothing(phase):
    simulator = simulator_of(**TIMED)
    stage(simulator, {"lane": 1, "position": 200.0}, BESIDE)
    agent = command(simulator, 0, 1, phase)
    for step in range(1, 21):
        simulator.step()
        row = simulator.agents[0, agent]
        assert row["outcome"] == (Outcome.TIMED_OUT if step == 20 else Outcome.UNFINISHED)
        assert CHANGER.terms_of(row)["reward_failure"] == 0.0
    assert simulator.roads[0]["is_done"] == 0
    assert simulator.vehicles[0, 0]["lane"] == 1
    assert simulator.vehicles[0, 0]["id"] == 0
    simulator.step()
    assert simulator.agents[0, agent]["vehicle"] == -1, "the slot is free"


def test_what_has_happened_by_then_counts_more_than_the_time():
    simulator = simulator_of(command={"time_limit": 0.1})
    for car, outcome in (
        ({"position": 200.0, "lateral_position": 9.375}, Outcome.COMPLETED),
        ({"position": 999.0}, Outcome.MISSED),
        ({"position": 200.0, "lateral_position": 10.2, "yaw": 1.0}, Outcome.OFF_ROAD),
        ({"position": 200.0}, Outcome.TIMED_OUT),
    ):
        stage(simulator, {"lane": 1, **car})
        agent = command(simulator, 0, 1)
        simulator.step()
        assert simulator.agents[0, agent]["outcome"] == outcome


def test_a_command_that_has_its_time_over_at_the_horizon_is_not_cut_off():
    simulator = simulator_of(command={"time_limit": 0.5}, horizon=0.5, num_agents=1)
    stage(simulator, {"lane": 1, "position": 200.0})
    agent = command(simulator, 0, 1)
    for _ in range(5):
        simulator.step()
    assert simulator.agents[0, agent]["outcome"] == Outcome.TIMED_OUT
    road = simulator.roads[0]
    assert (road["is_done"], road["is_cut"]) == (1, 0)


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize(
    ("way", "phase", "lane"),
    [
        # The body reaches the marking at 0.975 m: before it the car stays, beyond it goes over.
        (0.9, Phase.ENGAGED, 0),
        (1.0, Phase.ENGAGED, 1),
        (3.0, Phase.ENGAGED, 1),
        (5.0, Phase.ENGAGED, 1),
        # Wholly in the lane beyond its target, it does not come back over a marking.
        (7.5, Phase.ENGAGED, 2),
        (1.0, Phase.ABORTING, 0),
        (3.0, Phase.ABORTING, 1),
        (-3.75, Phase.WAITING, -1),
    ],
)
def test_no_marking_is_crossed_for_a_command_whose_time_is_over(direction, way, phase, lane):
    simulator = simulator_of(command={"time_limit": 0.1}, road={"num_lanes": 5})
    lateral = 9.375 + direction * way
    stage(simulator, {"lane": 2, "position": 200.0, "lateral_position": lateral})
    agent = command(simulator, 0, direction, phase)
    simulator.step()
    assert simulator.agents[0, agent]["outcome"] == Outcome.TIMED_OUT
    assert simulator.vehicles[0, 0]["lane"] == 2 + direction * lane


@pytest.mark.parametrize("time_limit", [0.8, 1.1, 1.2, 1.3, 1.5, 2.0, 3.0])
def test_a_vehicle_that_is_half_over_does_not_swerve(time_limit):
    """It stays, and does not touch the marking, or it goes over."""
    simulator = simulator_of(command={"time_limit": time_limit})
    stage(simulator, {"lane": 1, "position": 200.0, "speed": 25.0})
    agent = command(simulator, 0, 1)
    while simulator.agents[0, agent]["outcome"] == Outcome.UNFINISHED:
        simulator.step(damped_actions(simulator))
    car = simulator.vehicles[0]
    lane, accelerations, lanes = int(car["lane"][0]), [], []
    for _ in range(80):
        simulator.step()
        lanes.append((int(car["lane_low"][0]), int(car["lane_high"][0])))
        accelerations.append(float(abs(car["speed"][0] * car["yaw_rate"][0])))
    assert car["lateral_position"][0] == pytest.approx(3.75 * (lane + 0.5), abs=0.01)
    assert lanes == sorted(lanes), "it was over the marking and has come back"
    # Lane keeping's own from lane to lane is 1.5 m/s^2; back from half way it would be 3 m/s^2.
    assert max(accelerations) < 2.2
