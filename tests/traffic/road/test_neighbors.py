"""Order and neighbors, compared with a search over all pairs."""

import numpy as np
import pytest
from staging import TRUCK, command, simulator_of, stage

from marl_lanes.traffic.machine.state import Phase
from marl_lanes.traffic.road.neighbors import bumper_gap

OPEN_GAP = {"rule": "kinematic", "minimum_gap": 0.0, "time_gap": 0.0, "max_braking": 1000.0}

LIVE = [Phase.WAITING, Phase.ENGAGED, Phase.ABORTING]


def busy_road(simulator, generator):
    """Five lanes of vehicles at random speeds, some between two lanes, eight with commands."""
    places = [100.0 + 30.0 * place for place in range(4)]
    cars = [
        {
            "lane": lane,
            "position": place + 20.0 * generator.random(),
            "speed": generator.uniform(15.0, 30.0),
            "lateral_position": 3.75 * (lane + 0.5) + generator.choice([0.0, 0.0, -1.1, 1.1]),
        }
        for lane in range(5)
        for place in places
    ]
    stage(simulator, *cars)
    for vehicle in generator.choice(np.arange(4, 16), 8, replace=False).tolist():
        command(simulator, vehicle, generator.choice([-1, 1]), generator.choice(LIVE))


def is_in(simulator, slot, lane):
    """Whether the body is in the lane or the vehicle is engaged toward it."""
    car = simulator.vehicles[0, slot]
    if car["lane_low"] <= lane <= car["lane_high"]:
        return True
    agent = simulator.agents[0, car["agent"]]
    return car["agent"] >= 0 and agent["phase"] == Phase.ENGAGED and agent["target_lane"] == lane


def nearest(simulator, slot, lane, sign):
    """Slot of the nearest vehicle of the lane ahead (1) or behind (-1), or -1."""
    cars = simulator.vehicles[0]
    ahead = {
        other: sign * (cars["position"][other] - cars["position"][slot])
        for other in np.flatnonzero(cars["id"] >= 0).tolist()
        if other != slot and is_in(simulator, other, lane)
    }
    ahead = {other: distance for other, distance in ahead.items() if distance > 0.0}
    return min(ahead, key=ahead.__getitem__, default=-1)


def test_order_and_neighbors_are_those_of_a_search_of_all_pairs():
    simulator = simulator_of(road={"num_lanes": 5}, gap=OPEN_GAP)
    generator = np.random.default_rng(0)
    num_passed, found = 0, {"engaged": 0, "nobody": 0, "compared": 0}
    for _ in range(40):
        busy_road(simulator, generator)
        before = simulator.state.order[0, :20].tolist()
        simulator.step()
        cars, count = simulator.vehicles[0], int(simulator.roads["num_vehicles"][0])
        order = simulator.state.order[0, :count]
        assert (np.diff(cars["position"][order]) <= 0.0).all()
        assert sorted(order.tolist()) == np.flatnonzero(cars["id"] >= 0).tolist()
        num_passed += order.tolist() != [slot for slot in before if cars["id"][slot] >= 0]
        for agent in simulator.agents[0][simulator.is_live[0]]:
            for name, lane, sign in (
                ("leader", "origin_lane", 1),
                ("follower", "origin_lane", -1),
                ("target_leader", "target_lane", 1),
                ("target_follower", "target_lane", -1),
            ):
                wanted = nearest(simulator, agent["vehicle"], agent[lane], sign)
                assert agent[name] == wanted, name
                found["compared"] += 1
                found["nobody"] += wanted < 0
                other = cars[wanted]
                found["engaged"] += wanted >= 0 and not (
                    other["lane_low"] <= agent[lane] <= other["lane_high"]
                )
    assert num_passed > 20
    assert found["compared"] > 600
    assert found["engaged"] > 20
    assert found["nobody"] > 0


@pytest.mark.parametrize(("distance", "gap"), [(30.0, 25.2), (4.8, 0.0), (3.0, -1.8)])
def test_the_gap_is_from_bumper_to_bumper(distance, gap):
    simulator = simulator_of()
    stage(simulator, {"lane": 1, "position": 50.0}, {"lane": 1, "position": 50.0 + distance})
    rear, front = simulator.vehicles[0, 0], simulator.vehicles[0, 1]
    profiles = simulator.parameters.profiles
    assert bumper_gap(rear, front, profiles) == pytest.approx(gap, abs=1e-12)


@pytest.mark.parametrize(
    ("behind", "ahead", "gap"), [(0, TRUCK, 30.0 - 10.65), (TRUCK, 0, 19.35), (TRUCK, TRUCK, 13.5)]
)
def test_the_gap_is_between_half_of_each_length(behind, ahead, gap):
    """A car has 4.8 m, a truck 16.5 m."""
    simulator = simulator_of()
    stage(
        simulator,
        {"lane": 1, "position": 50.0, "profile": behind},
        {"lane": 1, "position": 80.0, "profile": ahead},
    )
    rear, front = simulator.vehicles[0, 0], simulator.vehicles[0, 1]
    assert bumper_gap(rear, front, simulator.parameters.profiles) == pytest.approx(gap)
