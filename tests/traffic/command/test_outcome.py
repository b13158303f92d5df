"""How a command ends: every outcome, and in which step."""

import numpy as np
import pytest
from staging import command, simulator_of, stage

from marl_lanes.traffic.machine.state import Outcome
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
