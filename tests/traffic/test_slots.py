"""Slots are only storage: the choice of slots has no influence on the traffic."""

import numpy as np
import pytest
from staging import command, damped_actions, rows_of, stage

from marl_lanes.traffic.machine.state import Disposition, Outcome, Phase
from marl_lanes.traffic.simulator import Simulator

BUSY = {
    "road": {"num_lanes": 5, "length": 500.0},
    "departures": {"interval": [0.8, 2.0], "initial_speed": [6.0, 14.0]},
    "warmup": [20.0, 30.0],
    "num_agents": None,
    "horizon": None,
    "max_vehicles": 60,
    "num_slots": 8,
    "command": {"probability": 0.9},
    "gap": {"rule": "kinematic"},
    "followers": {"mix": {"cooperative": 1.0, "neutral": 1.0, "adversarial": 1.0, "learned": 2.0}},
}
VEHICLE_INDICES = "vehicle", "leader", "follower", "target_leader", "target_follower"


def shuffle(simulator, vehicle_places, agent_places):
    """Move vehicle slot i to vehicle_places[i], and agent and follower slots to agent_places."""
    state = simulator.state
    to_vehicle, to_agent = np.append(vehicle_places, -1), np.append(agent_places, -1)
    for array in (state.agents, state.followers):
        for name in set(VEHICLE_INDICES) & set(array.dtype.names):
            array[name] = to_vehicle[array[name]]
    state.vehicles["changer"] = to_vehicle[state.vehicles["changer"]]
    state.vehicles["agent"] = to_agent[state.vehicles["agent"]]
    count = simulator.roads["num_vehicles"][0]
    state.order[0, :count] = vehicle_places[state.order[0, :count]]
    state.vehicles[0, vehicle_places] = state.vehicles[0].copy()
    for array in (
        state.agents,
        state.followers,
        state.observations,
        state.follower_observations,
        simulator.actions,
        simulator.follower_actions,
    ):
        array[0, agent_places] = array[0].copy()


def story(simulator):
    """The state of road 0 by ids and commands instead of slots."""
    state, cars, agents = (
        simulator.state,
        rows_of(simulator.vehicles[0]),
        rows_of(simulator.agents[0]),
    )
    ids = [*(car["id"] for car in cars), -1]
    commands = [*(agent["command"] for agent in agents), -1]
    told = {"road": rows_of(state.roads)[0]}
    for car in cars:
        if car["id"] >= 0:
            named = {"changer": ids[car["changer"]], "agent": commands[car["agent"]]}
            told["car", car["id"]] = car | named
    for slot, (agent, behind) in enumerate(zip(agents, rows_of(state.followers[0]), strict=True)):
        if agent["vehicle"] < 0:
            continue
        for kind, row in (("agent", agent), ("behind", behind)):
            named = {name: ids[row[name]] for name in VEHICLE_INDICES if name in row}
            told[kind, agent["command"]] = row | named
        told["seen", agent["command"]] = state.observations[0, slot].tobytes()
        told["seen behind", agent["command"]] = state.follower_observations[0, slot].tobytes()
    return told


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["dense", "interactive", "yielding"])
def test_a_step_does_not_depend_on_the_slots(scenario):
    one = Simulator(scenario, seed=3, overrides=BUSY, learned_followers=True)
    other = Simulator(scenario, seed=4, overrides=BUSY, learned_followers=True)
    generator = np.random.default_rng(3)
    one.reset()
    other.reset()
    num_engaged_together = 0
    for _ in range(900):
        one.actions[:] = damped_actions(one, 0.2, generator)
        one.follower_actions[:] = generator.uniform(-4.0, 4.0, one.follower_actions.shape)
        other.restore(one.snapshot())
        other.actions[:], other.follower_actions[:] = one.actions, one.follower_actions
        shuffle(other, generator.permutation(60), generator.permutation(8))
        assert story(one) == story(other)
        before = one.agents["phase"][0].copy()
        one.advance()
        other.advance()
        assert story(one) == story(other)
        is_new = (before == Phase.WAITING) & (one.agents["phase"][0] == Phase.ENGAGED)
        num_engaged_together += is_new.sum() > 1
    assert num_engaged_together > 0
    assert one.roads["num_commands"][0] > 25


@pytest.mark.parametrize("slots", [(0, 1), (1, 0)])
def test_an_agent_that_engages_can_be_a_follower_in_the_same_step(slots):
    """Two changers toward one lane engage in the same step; the rear one follows the front one."""
    simulator = Simulator(
        "paper",
        overrides={
            "warmup": [0.0, 0.0],
            "road": {"num_lanes": 5},
            "gap": {"rule": "kinematic", "minimum_gap": 0.0, "time_gap": 0.0},
        },
        seed=0,
    )
    simulator.reset()
    places = {slots[0]: {"lane": 1, "position": 130.0}, slots[1]: {"lane": 3, "position": 100.0}}
    stage(simulator, *(places[slot] for slot in (0, 1)))
    for vehicle in (0, 1):
        direction = 2 - int(simulator.vehicles[0, vehicle]["lane"])
        command(simulator, vehicle, direction, Phase.WAITING)
    simulator.step()
    front, rear = slots
    assert simulator.agents[0]["phase"][:2].tolist() == [Phase.ENGAGED] * 2
    assert simulator.agents[0, front]["target_follower"] == rear
    assert simulator.agents[0, rear]["target_leader"] == front
    assert simulator.vehicles[0, rear]["changer"] == front


@pytest.mark.parametrize("slots", [(0, 1), (1, 0)])
def test_if_two_agents_could_accept_one_gap_the_front_one_does(slots):
    simulator = Simulator(
        "paper", overrides={"warmup": [0.0, 0.0], "road": {"num_lanes": 5}}, seed=0
    )
    simulator.reset()
    places = {slots[0]: {"lane": 1, "position": 102.0}, slots[1]: {"lane": 3, "position": 100.0}}
    stage(simulator, *(places[slot] for slot in (0, 1)))
    for vehicle in (0, 1):
        direction = 2 - int(simulator.vehicles[0, vehicle]["lane"])
        command(simulator, vehicle, direction, Phase.WAITING)
    simulator.step()
    assert simulator.agents[0, slots[0]]["phase"] == Phase.ENGAGED
    assert simulator.agents[0, slots[1]]["phase"] == Phase.WAITING


@pytest.mark.parametrize("slots", [(0, 1), (1, 0)])
def test_two_agents_that_end_together_still_observe_each_other(slots):
    """In the last observation of each the other is still engaged, so in the target lane."""
    simulator = Simulator(
        "paper",
        overrides={
            "warmup": [0.0, 0.0],
            "road": {"num_lanes": 5},
            "num_agents": None,
            "horizon": 5.0,
        },
        seed=0,
    )
    simulator.reset()
    places = {slots[0]: {"lane": 1, "position": 140.0}, slots[1]: {"lane": 3, "position": 100.0}}
    stage(simulator, *(places[slot] for slot in (0, 1)))
    simulator.roads["step"] = 49
    for vehicle in (0, 1):
        command(simulator, vehicle, 2 - int(simulator.vehicles[0, vehicle]["lane"]))
        simulator.vehicles[0, vehicle]["disposition"] = Disposition.NEUTRAL
    simulator.step()
    assert simulator.agents[0]["outcome"][:2].tolist() == [Outcome.HORIZON] * 2
    assert simulator.agents[0, slots[0]]["target_follower"] == slots[1]
    assert simulator.agents[0, slots[1]]["target_leader"] == slots[0]
