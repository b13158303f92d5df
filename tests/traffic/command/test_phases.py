"""The life of a command: which vehicles get one, waiting, aborts."""

import itertools

import numpy as np
import pytest
from staging import command, damped_actions, simulator_of, stage

from marl_lanes.traffic.machine.state import Outcome, Phase
from marl_lanes.traffic.simulator import Simulator

ALWAYS = {"command": {"probability": 1.0}}


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


def test_from_an_outer_lane_the_change_is_to_the_only_side():
    overrides = {"command": {"probability": 1.0, "lanes": [0, 2, 4]}, "num_agents": None}
    simulator = Simulator("five_lanes", 4, seed=3, overrides=overrides)
    simulator.reset()
    rows = births(simulator, 300)
    ways = {(row["origin_lane"], row["direction"]) for row in rows}
    assert ways == {(0, 1), (2, 1), (2, -1), (4, -1)}


def test_of_two_lanes_both_are_commanded_and_both_changes_complete():
    overrides = {**ALWAYS, "num_agents": None}
    simulator = Simulator("two_lanes", 4, seed=3, overrides=overrides)
    simulator.reset()
    ended = []
    for _ in range(600):
        simulator.step(damped_actions(simulator))
        rows = simulator.agents[simulator.has_ended]
        assert (rows["direction"] == np.where(rows["origin_lane"] == 0, 1, -1)).all()
        ended += zip(rows["direction"].tolist(), rows["outcome"].tolist(), strict=True)
    for direction in (1, -1):
        outcomes = [outcome for way, outcome in ended if way == direction]
        assert len(outcomes) > 20
        assert outcomes.count(Outcome.COMPLETED) > 0.9 * len(outcomes)


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
