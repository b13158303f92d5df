"""The life of a command: which vehicles get one, waiting, aborts, every outcome, the reward."""

import itertools

import numpy as np
import pytest
from staging import command, damped_actions, stage

from marl_lanes.traffic.machine.state import Outcome, Phase
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.traffic.simulator import Simulator

ALWAYS = {"command": {"probability": 1.0}}


def simulator_of(**overrides):
    simulator = Simulator("paper", overrides={"warmup": [0.0, 0.0], **overrides})
    simulator.reset()
    return simulator


def births(simulator, num_steps, steer=damped_actions):
    """A row for every command in a rollout: its env, vehicle id, and fields at its beginning."""
    known = simulator.agents["command"].copy()
    rows = []
    for _ in range(num_steps):
        simulator.step(steer(simulator))
        is_new = simulator.is_live & (simulator.agents["command"] != known)
        for env, slot in np.argwhere(is_new):
            agent = simulator.agents[env, slot]
            car = simulator.vehicles[env, agent["vehicle"]]
            names = "command", "direction", "origin_lane", "target_lane", "born_step"
            row = {name: int(agent[name]) for name in names}
            row |= {"env": int(env), "id": int(car["id"]), "position": float(car["position"])}
            row["lane"] = int(car["lane"])
            rows.append(row)
        known = simulator.agents["command"].copy()
    return rows


def test_the_commanded_share_and_the_directions():
    simulator = Simulator("paper", 100, seed=3, overrides={"num_agents": None})
    simulator.reset()
    rows = births(simulator, 1500, lambda _: None)
    # 100 middle lanes, 150 s, one vehicle per 7.5 s: 2000 vehicles, one third commanded.
    assert len(rows) == pytest.approx(2000 / 3, rel=0.15)
    left = np.mean([row["direction"] == 1 for row in rows])
    assert left == pytest.approx(0.5, abs=0.06)


@pytest.mark.parametrize("name", ["paper", "five_lanes"])
def test_each_middle_lane_vehicle_is_commanded_once_where_the_scenario_says(name):
    overrides = {**ALWAYS, "num_agents": None, "num_slots": 32}
    simulator = Simulator(name, 16, seed=3, overrides=overrides)
    simulator.reset()
    rows = births(simulator, 600, lambda _: None)
    vehicles = [(row["env"], row["id"]) for row in rows]
    assert len(vehicles) == len(set(vehicles)) > 100
    last = simulator.scenario.road.num_lanes - 1
    assert {row["origin_lane"] for row in rows} == set(range(1, last))
    for row in rows:
        assert row["lane"] == row["origin_lane"]
        assert row["target_lane"] == row["origin_lane"] + row["direction"]
        # At most one step at 33 m/s beyond the last command position.
        assert 140.0 <= row["position"] < 160.0 + 3.4
    for env in range(16):
        numbers = [row["command"] for row in rows if row["env"] == env]
        assert sorted(numbers) == list(range(len(numbers)))
        assert simulator.roads["num_commands"][env] == len(numbers)


def test_only_the_named_lanes_are_commanded():
    overrides = {**ALWAYS, "num_agents": None}
    overrides["command"] = {"probability": 1.0, "lanes": [3], "position": [50.0, 60.0]}
    simulator = Simulator("five_lanes", 2, seed=3, overrides=overrides)
    simulator.reset()
    rows = births(simulator, 300)
    assert {row["origin_lane"] for row in rows} == {3}
    assert min(row["position"] for row in rows) >= 50.0
    assert max(row["position"] for row in rows) < 64.0


def test_few_slots_delay_commands_and_lose_none():
    overrides = {**ALWAYS, "num_slots": 1, "num_agents": 6}
    simulator = Simulator("dense", 3, seed=1, overrides=overrides)
    simulator.reset()
    latest = 0.0
    for _ in range(6000):
        rows = births(simulator, 1)
        latest = max([latest, *(row["position"] for row in rows)])
        assert (simulator.roads["num_live"] <= 1).all()
        if simulator.roads["is_done"].all():
            break
    assert (simulator.roads["num_commands"] == 6).all()
    assert latest > 170.0


@pytest.mark.parametrize("num_agents", [1, 3])
def test_num_agents_ends_the_episode(num_agents):
    simulator = Simulator("paper", 2, seed=1, overrides={**ALWAYS, "num_agents": num_agents})
    simulator.reset()
    ended = np.zeros(2, int)
    for _ in range(3000):
        assert (simulator.roads["is_done"] == (ended == num_agents)).all()
        if simulator.roads["is_done"].all():
            break
        simulator.step(damped_actions(simulator))
        ended += simulator.has_ended.sum(axis=1)
    assert (ended == num_agents).all()
    assert (simulator.roads["num_commands"] == num_agents).all()
    assert (simulator.roads["num_live"] == 0).all()


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


def test_a_waiting_agents_action_is_ignored_and_its_reward_is_zero():
    blocked = {"gap": {"minimum_gap": 5000.0}, **ALWAYS}
    twins = [Simulator("dense", 2, seed=6, overrides=blocked) for _ in range(2)]
    for simulator in twins:
        simulator.reset()
    generator = np.random.default_rng(0)
    waited = 0
    for _ in range(300):
        twins[0].step()
        twins[1].step(generator.uniform(-5.0, 5.0, (2, twins[1].num_slots, 1)))
        assert twins[0].state.tobytes() == twins[1].state.tobytes()
        assert not twins[0].is_steering.any()
        assert (twins[0].agents["reward"] == 0.0).all()
        waited += int(twins[0].is_live.sum())
    assert waited > 500


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


def test_a_violated_gap_aborts_before_the_marking_and_the_agent_waits_again():
    simulator = simulator_of(departures={"interval": [900.0, 900.0]})
    stage(
        simulator,
        {"lane": 1, "position": 200.0, "lateral_position": 6.0},
        {"lane": 2, "position": 190.0},
    )
    agent = command(simulator, 0, 1)
    simulator.step()
    row = simulator.agents[0, agent]
    assert row["phase"] == Phase.ABORTING
    assert row["num_aborts"] == 1
    # The reference is now the origin lane's centre: 5.625 - 6.0, positive to the left.
    assert simulator.state.observations[0, agent, 2] == pytest.approx(-0.375, abs=1e-6)
    phases = [Phase.ABORTING]
    for _ in range(80):
        simulator.vehicles[0, 1]["position"] = simulator.vehicles[0, 0]["position"] - 5.0
        simulator.step(damped_actions(simulator))
        phases.append(Phase(int(simulator.agents[0, agent]["phase"])))
    assert [phase for phase, _ in itertools.groupby(phases)] == [Phase.ABORTING, Phase.WAITING]
    assert simulator.vehicles[0, 0]["lateral_position"] == pytest.approx(5.625, abs=0.2)
    # The other vehicle goes away: the same command engages again and completes.
    simulator.vehicles[0, 1]["position"] = 10.0
    outcomes = []
    for _ in range(150):
        simulator.step(damped_actions(simulator))
        outcomes.append(int(simulator.agents[0, agent]["outcome"]))
    assert Outcome.COMPLETED in outcomes
    assert simulator.agents[0, agent]["num_aborts"] == 1


def test_over_the_marking_no_agent_aborts():
    simulator = simulator_of()
    for lateral, phase in ((6.59, Phase.ABORTING), (6.61, Phase.ENGAGED)):
        stage(
            simulator,
            {"lane": 1, "position": 200.0, "lateral_position": lateral},
            {"lane": 2, "position": 192.0},
        )
        agent = command(simulator, 0, 1)
        simulator.step()
        assert simulator.agents[0, agent]["phase"] == phase


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


def test_the_reward_is_the_sum_of_its_terms_by_hand():
    simulator = simulator_of()
    stage(simulator, {"lane": 1, "position": 200.0, "yaw_rate": 0.02})
    agent = command(simulator, 0, -1)
    simulator.step(np.full((1, simulator.num_slots, 1), 0.3))
    row = simulator.agents[0, agent]
    # To the right: the yaw acceleration is -0.3 rad/s^2, the yaw rate 0.02 - 0.03.
    speed = 20.0 + 0.2 * (1.0 - (2.0 / 3.0) ** 4)
    deviation = 3.75 + speed * np.sin(-0.001) * 0.1
    paid = CHANGER.terms_of(row)
    assert paid["reward_yaw_acceleration"] == pytest.approx(-2.0 * 0.3)
    assert paid["reward_yaw_rate"] == pytest.approx(-0.5 * 0.01)
    assert paid["reward_deviation"] == pytest.approx(-0.05 * deviation / 1.875)
    expected = -0.605 - 0.05 * deviation / 1.875
    assert row["reward"] == row["episode_reward"] == pytest.approx(expected)
    assert row["steering_steps"] == 1


def test_on_an_arc_only_turning_relative_to_the_road_is_punished():
    arcs = [{"start": 0.0, "end": 900.0, "radius": 400.0}]
    simulator = simulator_of(road={"arcs": arcs})
    rate = 20.0 / (400.0 - 5.625)
    stage(simulator, {"lane": 1, "position": 200.0, "yaw_rate": rate, "desired_speed": 20.0})
    agent = command(simulator, 0, 1)
    simulator.step()
    assert simulator.vehicles[0, 0]["yaw_rate"] == pytest.approx(rate)
    paid = CHANGER.terms_of(simulator.agents[0, agent])
    assert paid["reward_yaw_rate"] == pytest.approx(0.0, abs=1e-12)
