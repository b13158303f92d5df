"""Accelerations of changer and follower without the change, by hand and in traffic."""

import math

import numpy as np
import pytest
from staging import MIXED, TRUCK, command, damped_actions, stage

from marl_lanes import Simulator, load_scenario
from marl_lanes.traffic.counterfactual import accelerations_without_change
from marl_lanes.traffic.machine.state import Phase

PAPER = load_scenario("paper")
V0, A, B = 30.0, 2.0, 1.5
LENGTH = PAPER.vehicle.length


def law(speed, leaders=(), *, s0=5.0, headway=1.0):
    """Eq. 9 behind leaders, each (gap, speed) [m, m/s], of a normal driver with v0 = 30 m/s."""
    terms = [(speed / V0) ** 4]
    for gap, ahead in leaders:
        wanted = s0 + speed * headway + speed * (speed - ahead) / (2.0 * math.sqrt(A * B))
        terms.append((wanted / gap) ** 2)
    return max(-8.0, A * (1.0 - max(terms)))


def staged(*cars, scenario=PAPER, changers=((0, 1),), phase=Phase.ENGAGED):
    """Accelerations with cars on road 1 of 2, for changers, each (vehicle slot, direction)."""
    simulator = Simulator(scenario, 2, seed=0)
    simulator.reset()
    stage(simulator, env=0)
    stage(simulator, *cars, env=1)
    agents = [command(simulator, slot, direction, phase, env=1) for slot, direction in changers]
    vehicles = simulator.vehicles[1]
    for (slot, direction), index in zip(changers, agents, strict=True):
        for side, sign in (("leader", 1.0), ("follower", -1.0)):
            for name, lane in ((side, 0), (f"target_{side}", direction)):
                wanted = vehicles["lane"][slot] + lane
                ahead = sign * (vehicles["position"] - vehicles["position"][slot])
                is_in = (vehicles["lane_low"] <= wanted) & (wanted <= vehicles["lane_high"])
                fits = np.flatnonzero((vehicles["id"] >= 0) & is_in & (ahead > 0.0))
                nearest = fits[np.argmin(ahead[fits])] if fits.size else -1
                simulator.agents[1, index][name] = nearest
    found = accelerations_without_change(simulator.state, simulator.parameters)
    for one in found:
        assert np.isnan(one[0]).all()
    return [[one[1, index] for index in agents] for one in found]


def test_the_changer_follows_only_its_origin_leader():
    cars = ({"lane": 1, "position": 300.0, "speed": 20.0}, {"lane": 2, "position": 312.0})
    (alone,), _ = staged(*cars)
    assert alone == pytest.approx(law(20.0))
    origin = {"lane": 1, "position": 330.0, "speed": 15.0}
    (behind,), _ = staged(*cars, origin)
    assert behind == pytest.approx(law(20.0, [(30.0 - LENGTH, 15.0)]))
    near = {"lane": 1, "position": 306.0, "speed": 0.0}
    assert staged(cars[0], near)[0] == [-8.0]


def test_the_follower_follows_the_vehicle_ahead_of_the_changer():
    changer = {"lane": 1, "position": 300.0, "speed": 20.0, "lateral_position": 7.0}
    follower = {"lane": 2, "position": 285.0, "speed": 22.0}
    _, (free,) = staged(changer, follower)
    assert free == pytest.approx(law(22.0))
    leader = {"lane": 2, "position": 320.0, "speed": 18.0}
    _, (held,) = staged(changer, follower, leader)
    assert held == pytest.approx(law(22.0, [(35.0 - LENGTH, 18.0)]))
    assert held < free
    assert math.isnan(staged(changer)[1][0])


def test_a_follower_in_two_lanes_follows_in_both():
    changer = {"lane": 1, "position": 300.0, "speed": 20.0}
    follower = {"lane": 2, "position": 285.0, "speed": 22.0, "lateral_position": 7.6}
    ahead = {"lane": 1, "position": 315.0, "speed": 20.0}
    other = {"lane": 2, "position": 330.0, "speed": 22.0}
    _, (found,) = staged(changer, follower, ahead, other)
    assert found == pytest.approx(law(22.0, [(30.0 - LENGTH, 20.0)]))


def test_the_followers_disposition_has_no_effect():
    """An adversarial driver does not accelerate more, and a cooperative one does not yield."""
    changer = {"lane": 1, "position": 300.0, "speed": 20.0}
    for disposition in range(3):
        follower = {"lane": 2, "position": 285.0, "speed": 22.0, "disposition": disposition}
        assert staged(changer, follower)[1][0] == pytest.approx(law(22.0))


def test_an_aborting_changer_counts_and_a_waiting_one_does_not():
    cars = ({"lane": 1, "position": 300.0}, {"lane": 2, "position": 285.0, "speed": 22.0})
    assert staged(*cars, phase=Phase.ABORTING)[1][0] == pytest.approx(law(22.0))
    changers, followers = staged(*cars, phase=Phase.WAITING)
    assert math.isnan(changers[0])
    assert math.isnan(followers[0])


@pytest.mark.parametrize("name", ["paper", "curved"])
def test_in_traffic_they_drive_so_as_long_as_the_change_has_no_effect(name):
    """Neutral followers and changers without target leader, before the body is in the lane."""
    sparse = {"departures": {"interval": [2.0, 60.0]}}
    simulator = Simulator(load_scenario(name, sparse), 40, seed=3)
    simulator.reset()
    compared = [0, 0]
    for _ in range(800):
        agents = simulator.agents.copy()
        before = simulator.vehicles.copy()
        found = accelerations_without_change(simulator.state, simulator.parameters)
        simulator.step(damped_actions(simulator))
        for env, slot in np.argwhere(agents["phase"] == Phase.ENGAGED).tolist():
            agent, cars = agents[env, slot], before[env]
            car, behind = cars[agent["vehicle"]], cars[agent["target_follower"]]
            is_out = not car["lane_low"] <= agent["target_lane"] <= car["lane_high"]
            driven = simulator.vehicles["acceleration"][env]
            if agent["target_follower"] >= 0 and is_out and behind["agent"] < 0:
                assert abs(driven[agent["target_follower"]] - found[1][env, slot]) < 1e-9
                compared[1] += 1
            if agent["target_leader"] < 0 and is_out:
                assert abs(driven[agent["vehicle"]] - found[0][env, slot]) < 1e-9
                compared[0] += 1
    assert min(compared) > 50


def test_gaps_are_those_of_the_vehicles_lengths():
    """A changer behind a truck, a truck behind the changer that follows a car."""
    scenario = load_scenario(PAPER, MIXED)
    changer = {"lane": 1, "position": 300.0, "speed": 20.0, "lateral_position": 7.0}
    truck = {"lane": 1, "position": 340.0, "speed": 15.0, "profile": TRUCK}
    follower = {"lane": 2, "position": 260.0, "speed": 20.0, "profile": TRUCK}
    leader = {"lane": 2, "position": 320.0, "speed": 18.0}
    found = staged(changer, truck, follower, leader, scenario=scenario)
    assert found[0][0] == pytest.approx(law(20.0, [(40.0 - 10.65, 15.0)]))
    # s0 = 2 m, T = 2 s, a_m = 0.6 and b = 2 m/s^2 of the truck.
    wanted = 2.0 + 20.0 * 2.0 + 20.0 * 2.0 / (2.0 * math.sqrt(1.2))
    assert found[1][0] == pytest.approx(0.6 * (1.0 - (wanted / (60.0 - 10.65)) ** 2))
