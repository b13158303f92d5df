"""Traffic: conservation of vehicles, no collisions without actions."""

import numpy as np
import pytest
from staging import assert_conserved, damped_actions, present

from marl_lanes.scenario import list_scenarios
from marl_lanes.traffic.simulator import Simulator

NO_COMMANDS = {"command": {"probability": 0.0}}
OPEN_GAP = {"gap": {"rule": "kinematic", "minimum_gap": 0.0, "time_gap": 0.0, "max_braking": 100.0}}


@pytest.mark.parametrize("name", ["paper", "dense"])
def test_ten_million_vehicle_steps_without_a_collision(name):
    num_envs = 200 if name == "paper" else 64
    simulator = Simulator(name, num_envs, seed=11, num_threads=1, overrides=NO_COMMANDS)
    simulator.reset()
    vehicle_steps = 0
    while vehicle_steps < 10_000_000:
        simulator.step()
        vehicle_steps += int(simulator.roads["num_vehicles"].sum())
    assert simulator.roads["num_collisions"].sum() == 0
    assert simulator.roads["num_off_road"].sum() == 0
    assert simulator.roads["num_commands"].sum() == 0
    assert simulator.roads["num_left"].sum() > 10_000
    assert_conserved(simulator)


@pytest.mark.parametrize("name", ["aggressive", "defensive"])
@pytest.mark.parametrize("form", ["max", "sum", "acc"])
def test_no_profile_collides_in_crowded_traffic(name, form):
    overrides = {
        **NO_COMMANDS,
        "drivers": {"mix": {name: 1.0}, "car_following": form},
        "departures": {"initial_speed": [5.0, 35.0], "desired_speed": [8.0, 45.0]},
    }
    simulator = Simulator("dense", 16, seed=3, overrides=overrides)
    simulator.reset()
    for _ in range(1500):
        simulator.step()
    assert simulator.roads["num_collisions"].sum() == 0
    assert simulator.vehicles["speed"][present(simulator)].min() >= 0.0
    assert_conserved(simulator)


@pytest.mark.parametrize("name", list_scenarios())
def test_vehicles_are_conserved_under_random_actions(name):
    simulator = Simulator(name, 3, seed=5, overrides={"command": {"probability": 1.0}})
    generator = np.random.default_rng(5)
    simulator.reset()
    assert_conserved(simulator)
    for _ in range(250):
        simulator.step(
            generator.uniform(-1.0, 1.0, (3, simulator.num_slots, simulator.num_actions))
        )
        assert_conserved(simulator)
    assert simulator.roads["num_left"].sum() > 0


@pytest.mark.parametrize("bias", [0.0, 0.6])
def test_vehicles_are_conserved_when_they_collide(bias):
    overrides = {
        **OPEN_GAP,
        "command": {"probability": 1.0},
        "time_step": 0.25,
        "num_agents": None,
        "followers": {"mix": {"adversarial": 1.0}},
    }
    simulator = Simulator("dense", 6, seed=8, overrides=overrides)
    generator = np.random.default_rng(8)
    simulator.reset()
    for _ in range(500):
        simulator.step(damped_actions(simulator, 0.3, generator) + bias)
        assert_conserved(simulator)
    assert simulator.roads["num_collided"].sum() > 0
    # A vehicle collides once, with one other or with several.
    assert (simulator.roads["num_collided"] <= 2 * simulator.roads["num_collisions"]).all()
