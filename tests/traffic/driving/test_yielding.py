"""Cooperative followers that move over: conditions, motion, and no collisions."""

import math

import numpy as np
import pytest
from staging import command, stage

from marl_lanes.traffic.machine.state import Disposition, Phase
from marl_lanes.traffic.simulator import Simulator

FREE = 2.0 * (1.0 - (20.0 / 30.0) ** 4)
"""[m/s^2] at 20 m/s on a free road, desired speed 30 m/s."""


def simulator_of(*, moves_over=True, num_lanes=5, **overrides):
    followers = {"cooperative": {"moves_over": moves_over}}
    fields = {"warmup": [0.0, 0.0], "road": {"num_lanes": num_lanes}, "followers": followers}
    simulator = Simulator("paper", overrides=fields | overrides, seed=0)
    simulator.reset()
    return simulator


def meet(simulator, *others, gap=15.0, direction=1, follower=None, changer=None):
    """A cooperative follower (slot 0) behind a changer (slot 1) engaged toward its lane, 2."""
    stage(
        simulator,
        {"lane": 2, "position": 200.0, "disposition": Disposition.COOPERATIVE, "changer": 1}
        | (follower or {}),
        {"lane": 2 - direction, "position": 204.8 + gap} | (changer or {}),
        *others,
    )
    command(simulator, 1, direction)
    return simulator.vehicles[0, 0]


def counted(simulator):
    return (
        int(simulator.roads["num_moves_over"][0]),
        int(simulator.roads["num_moves_returned"][0]),
    )


@pytest.mark.parametrize("direction", [1, -1])
def test_it_keeps_the_lane_beyond_instead_of_braking(direction):
    simulator = simulator_of()
    car = meet(simulator, direction=direction)
    simulator.step()
    assert (car["lane"], car["moving_over"]) == (2 + direction, direction)
    assert car["acceleration"] == pytest.approx(FREE)
    assert np.sign(car["yaw_rate"]) == direction
    assert counted(simulator) == (1, 0)


BESIDE = {"lane": 3, "position": 203.0}
STAYS = {
    "field off": ({"moves_over": False}, {}, ()),
    "no lane beyond": ({"num_lanes": 3}, {}, ()),
    "neutral": ({}, {"follower": {"disposition": Disposition.NEUTRAL}}, ()),
    "adversarial": ({}, {"follower": {"disposition": Disposition.ADVERSARIAL}}, ()),
    "far": ({}, {"gap": 120.0}, ()),
    "slow": ({}, {"gap": 3.0, "follower": {"speed": 4.9}, "changer": {"speed": 4.9}}, ()),
    "body in": ({}, {"changer": {"lateral_position": 6.7}}, ()),
    "not settled": ({}, {"follower": {"lateral_position": 9.7}}, ()),
    "turning": ({}, {"follower": {"yaw": 0.1}, "completion": 0.25}, ()),
    "somebody beside": ({}, {}, (BESIDE,)),
    "somebody fast behind": ({}, {}, ({"lane": 3, "position": 180.0, "speed": 35.0},)),
    "somebody slow ahead": ({}, {}, ({"lane": 3, "position": 212.0, "speed": 12.0},)),
    "no better there": (
        {
            "gap": {
                "rule": "kinematic",
                "minimum_gap": 0.0,
                "time_gap": 0.0,
                "max_braking": 50.0,
            }
        },
        {},
        ({"lane": 3, "position": 212.0, "speed": 18.0},),
    ),
}


@pytest.mark.parametrize("name", STAYS)
def test_it_stays_if_it_may_not_or_need_not_move_over(name):
    fields, staging, others = STAYS[name]
    staging = dict(staging)
    if "completion" in staging:
        fields = {**fields, "completion": {"max_lateral_speed": staging.pop("completion")}}
    simulator = simulator_of(**fields)
    car = meet(simulator, *others, **staging)
    lane = int(car["lane"])
    simulator.step()
    assert (car["lane"], car["moving_over"]) == (lane, 0)
    assert counted(simulator) == (0, 0)
    if name in ("field off", "no lane beyond", "somebody beside", "somebody fast behind"):
        # It brakes gently for the changer, as without moving over.
        assert car["acceleration"] == -2.0


def test_a_driver_with_a_command_does_not_move_over():
    simulator = simulator_of()
    car = meet(simulator, {"lane": 3, "position": 400.0})
    command(simulator, 0, 1, Phase.WAITING)
    simulator.step()
    assert car["moving_over"] == 0


def test_it_counts_as_being_in_the_lane_beyond_at_once():
    """A changer beside it in lane 4, toward lane 3, has to wait; one behind follows it."""
    simulator = simulator_of()
    meet(
        simulator,
        {"lane": 4, "position": 203.0},
        {"lane": 4, "position": 176.0},
        {"lane": 3, "position": 60.0},
    )
    waiting = command(simulator, 2, -1, Phase.WAITING)
    behind = command(simulator, 3, -1)
    simulator.step()
    assert simulator.agents[0, waiting]["phase"] == Phase.WAITING
    assert simulator.agents[0, waiting]["target_follower"] == 0
    assert simulator.agents[0, behind]["target_leader"] == 0
    simulator.step()
    # On a free road it would accelerate: it already follows the vehicle that moves over.
    assert simulator.vehicles[0, 3]["acceleration"] < 0.0


def test_if_two_could_take_one_gap_the_front_one_takes_it():
    simulator = simulator_of(num_lanes=7)
    cooperative = {"disposition": Disposition.COOPERATIVE}
    stage(
        simulator,
        {"lane": 2, "position": 200.0, "changer": 1} | cooperative,
        {"lane": 1, "position": 220.0},
        {"lane": 4, "position": 202.0, "changer": 3} | cooperative,
        {"lane": 5, "position": 220.0},
    )
    command(simulator, 1, 1)
    command(simulator, 3, -1)
    simulator.step()
    assert simulator.vehicles[0]["lane"][[0, 2]].tolist() == [2, 3]
    assert simulator.vehicles[0]["moving_over"][[0, 2]].tolist() == [0, -1]
    assert counted(simulator) == (1, 0)


def test_it_settles_in_the_lane_beyond_gently_and_the_move_is_over():
    simulator = simulator_of(completion={"max_lateral_speed": 0.25})
    car = meet(simulator, gap=25.0)
    lateral, sideways, duration = [], [], 0
    for count in range(100):
        simulator.step()
        lateral.append(float(car["lateral_position"]))
        sideways.append(float(car["speed"] * math.sin(car["yaw"])))
        duration = duration if car["moving_over"] else duration or count
    assert (car["lane"], car["moving_over"]) == (3, 0)
    assert lateral[-1] == pytest.approx(13.125, abs=1e-3)
    assert max(lateral) < 13.2
    assert min(lateral) >= 9.375 - 1e-9
    assert 0.9 < max(sideways) < 1.05
    # v omega: the lateral acceleration.
    assert np.abs(np.diff(sideways) / 0.1).max() < 1.7
    assert 35 < duration < 60
    assert counted(simulator) == (1, 0)


def test_it_goes_back_if_the_gap_becomes_unsafe_before_the_marking():
    simulator = simulator_of()
    car = meet(simulator, {"lane": 3, "position": 60.0, "speed": 20.0}, gap=25.0)
    simulator.step()
    assert car["moving_over"] == 1
    other = simulator.vehicles[0, 2]
    other["position"], other["speed"] = car["position"] - 6.0, 30.0
    simulator.step()
    assert (car["lane"], car["moving_over"]) == (2, 0)
    assert counted(simulator) == (1, 1)
    for _ in range(60):
        simulator.step()
    assert car["lateral_position"] == pytest.approx(9.375, abs=0.05)


def test_it_does_not_go_back_once_its_body_is_over_the_marking():
    simulator = simulator_of()
    car = meet(simulator, {"lane": 3, "position": 20.0, "speed": 20.0}, gap=25.0)
    while car["lane_high"] == 2:
        simulator.step()
    other = simulator.vehicles[0, 2]
    other["position"], other["speed"] = car["position"] - 20.0, 25.0
    simulator.step()
    assert (car["lane"], car["moving_over"]) == (3, 1)
    # The vehicle behind reacts to the body.
    assert other["acceleration"] == -8.0
    assert counted(simulator) == (1, 0)


def test_it_is_not_commanded_before_the_move_is_over():
    simulator = simulator_of(command={"probability": 1.0, "position": [100.0, 100.0]})
    car = meet(simulator, gap=25.0, follower={"command_position": 100.0})
    was_moving = 0
    while car["agent"] == -1:
        assert np.isfinite(car["command_position"])
        simulator.step()
        was_moving += int(car["moving_over"])
        if car["moving_over"]:
            assert car["agent"] == -1
    assert was_moving > 30
    agent = simulator.agents[0, car["agent"]]
    assert (agent["origin_lane"], car["moving_over"]) == (3, 0)


def test_while_it_moves_it_follows_the_leaders_of_both_lanes():
    simulator = simulator_of()
    car = meet(simulator, {"lane": 3, "position": 260.0}, {"lane": 2, "position": 400.0})
    simulator.step()
    assert car["moving_over"] == 1
    row = simulator.vehicles[0, 2]
    for slot in (2, 3):
        row, other = simulator.vehicles[0, slot], simulator.vehicles[0, 5 - slot]
        row["position"], row["speed"] = car["position"] + 34.8, float(car["speed"])
        other["position"] = 500.0
        simulator.state.order[0, :4] = [5 - slot, slot, 1, 0]
        speed = float(car["speed"])
        simulator.step()
        assert car["moving_over"] == 1
        assert car["acceleration"] == pytest.approx(2.0 * (1.0 - ((5.0 + speed) / 30.0) ** 2))


def steering(simulator):
    """(E, A, D): simple steering of all changers at once; deviations count up to 2 m."""
    actions = np.zeros((*simulator.agents.shape, simulator.num_actions))
    if simulator.num_actions == 2:
        actions[..., 1] = simulator.agents["car_following"]
    roads, slots = simulator.is_steering.nonzero()
    agents = simulator.agents[roads, slots]
    cars = simulator.vehicles[roads, agents["vehicle"]]
    is_back = agents["phase"] == Phase.ABORTING
    lanes = np.where(is_back, agents["origin_lane"], agents["target_lane"])
    centres = (lanes + 0.5) * simulator.scenario.road.lane_width
    error = np.clip(centres - cars["lateral_position"], -2.0, 2.0)
    wanted = error / np.maximum(cars["speed"], 1.0) - 3.0 * (cars["yaw"] + cars["yaw_rate"])
    actions[roads, slots, 0] = agents["direction"] * wanted
    return actions


FAST_AND_SLOW = {"initial_speed": [6.0, 25.0], "desired_speed": [12.0, 40.0]}
SOAK = {
    "yielding": ("yielding", {}),
    "four lanes": ("paper", {"road": {"num_lanes": 4}, "departures": {"interval": [1.5, 3.0]}}),
    "all drivers": (
        "paper",
        {
            "road": {"num_lanes": 5},
            "departures": {"interval": [0.8, 2.0], **FAST_AND_SLOW},
            "drivers": {"mix": {"normal": 1.0, "aggressive": 1.0, "defensive": 1.0}},
        },
    ),
    "two actions": ("interactive", {"road": {"num_lanes": 6}}),
}


@pytest.mark.parametrize("name", SOAK)
def test_a_million_vehicle_steps_without_a_collision(name):
    scenario, fields = SOAK[name]
    mix = {"cooperative": 2.0, "neutral": 1.0, "adversarial": 1.0}
    overrides = {
        **fields,
        "followers": {"mix": mix, "cooperative": {"moves_over": True}},
        "command": {"probability": 0.7},
        "num_agents": None,
        "horizon": None,
        "max_vehicles": 192,
        "num_slots": 24,
    }
    simulator = Simulator(scenario, 16, seed=5, overrides=overrides, num_threads=1)
    simulator.reset()
    vehicle_steps, sideways, is_commanded = 0, 0.0, False
    while vehicle_steps < 1_500_000:
        simulator.step(steering(simulator))
        vehicle_steps += int(simulator.roads["num_vehicles"].sum())
        cars = simulator.vehicles[simulator.vehicles["moving_over"] != 0]
        sideways = max(sideways, np.abs(cars["speed"] * np.sin(cars["yaw"])).max(initial=0.0))
        is_commanded |= bool((cars["agent"] >= 0).any())
    roads = simulator.roads
    assert roads["num_collisions"].sum() == 0
    assert roads["num_off_road"].sum() == 0
    assert not is_commanded
    assert roads["num_moves_over"].sum() > 10
    assert (roads["num_moves_returned"] <= roads["num_moves_over"]).all()
    assert 0.9 < sideways < 1.2
    assert roads["num_commands"].sum() > 400
