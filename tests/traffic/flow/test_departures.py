"""Vehicles that enter: when, where, at which speed, with which driver; the warm-up."""

import numpy as np
import pytest
from staging import MIXED, TRUCK, assert_conserved, present, stage

from marl_lanes.traffic.simulator import Simulator

NO_COMMANDS = {"command": {"probability": 0.0}}


def test_a_departure_waits_for_room():
    """In a queue at the road's entrance an entering vehicle keeps at least s0 to its leader."""
    overrides = {
        **NO_COMMANDS,
        "departures": {"interval": [0.5, 1.0], "initial_speed": [4.0, 30.0]},
        "drivers": {"mix": {"normal": 1.0, "aggressive": 1.0, "defensive": 1.0}},
    }
    simulator = Simulator("dense", 8, seed=2, overrides=overrides)
    simulator.reset()
    was_late = 0
    for _ in range(600):
        entered_before = simulator.roads["num_entered"].copy()
        simulator.step()
        now = simulator.roads["step"] * 0.1
        was_late += int((simulator.state.lanes["next_departure"] < now[:, None] - 0.05).sum())
        for env in np.flatnonzero(simulator.roads["num_entered"] > entered_before):
            cars = simulator.vehicles[env][present(simulator)[env]]
            for lane in range(3):
                ranked = np.sort(cars["position"][cars["lane"] == lane])
                if ranked.size > 1 and ranked[0] == 0.0:
                    # At least the smallest s0 of the profiles.
                    assert ranked[1] - ranked[0] - 4.8 >= 3.0
    assert was_late > 0
    assert simulator.roads["num_collisions"].sum() == 0


def test_a_full_road_makes_departures_wait():
    overrides = {**NO_COMMANDS, "max_vehicles": 6}
    simulator = Simulator("dense", 2, overrides=overrides, seed=0)
    simulator.reset()
    for _ in range(800):
        simulator.step()
        assert (simulator.roads["num_vehicles"] <= 6).all()
    assert (simulator.roads["num_left"] > 6).all()
    assert_conserved(simulator)


def test_a_free_place_is_for_the_vehicle_that_has_waited_longest():
    simulator = Simulator("paper", overrides={**NO_COMMANDS, "warmup": [0.0, 0.0]})
    simulator.reset()
    places = {"lane": 1, "position": 500.0}
    stage(simulator, *({**places, "position": 500.0 + 8.0 * n} for n in range(63)))
    simulator.state.lanes[0]["next_departure"] = [-1.0, -3.0, -2.0]
    simulator.step()
    entered = simulator.vehicles[0, simulator.vehicles[0]["id"] == 63]
    assert entered["lane"].tolist() == [1]
    # Two lanes waited one step, then all three a second one.
    assert simulator.roads["num_held_back"][0] == 2
    simulator.state.lanes[0]["next_departure"][1] = 0.0
    simulator.step()
    assert simulator.roads["num_held_back"][0] == 5


def test_no_lane_starves_and_it_is_said_that_the_road_was_full(caplog):
    overrides = {**NO_COMMANDS, "departures": {"interval": [1.0, 1.5]}, "max_vehicles": 20}
    simulator = Simulator("paper", 4, overrides={**overrides, "warmup": [0.0, 0.0]})
    simulator.reset()
    assert not caplog.records
    lanes = np.zeros(3, int)
    for _ in range(1500):
        before = simulator.roads["num_entered"].copy()
        simulator.step()
        lanes += np.bincount(
            simulator.vehicles["lane"][simulator.vehicles["id"] >= before[:, None]], minlength=3
        )
    assert lanes.min() > 0.9 * lanes.max() > 50
    assert (simulator.roads["num_held_back"] > 1000).all()
    for _ in range(2):
        simulator.reset()
    (record,) = caplog.records
    assert "max_vehicles = 20 were on a road" in record.getMessage()


def test_the_shipped_scenario_has_a_place_for_every_departure():
    simulator = Simulator("paper", 40, overrides=NO_COMMANDS)
    simulator.reset()
    for _ in range(300):
        simulator.step()
    assert not simulator.roads["num_held_back"].any()


def test_departures_follow_the_scenario():
    simulator = Simulator("paper", 40, seed=1, overrides={**NO_COMMANDS, "warmup": [0.0, 0.0]})
    simulator.reset()
    assert (simulator.roads["num_vehicles"] == 0).all()
    fresh = []
    for _ in range(1200):
        entered_before = simulator.roads["num_entered"].copy()
        simulator.step()
        fresh.append(simulator.vehicles[simulator.vehicles["id"] >= entered_before[:, None]].copy())
    cars = np.concatenate(fresh)
    per_lane = np.bincount(cars["lane"], minlength=3) / 40
    # 120 s with one vehicle per 7.5 s, and slightly fewer: some wait behind a slow leader.
    assert ((per_lane > 14.0) & (per_lane < 17.0)).all()
    assert (cars["position"] == 0.0).all()
    assert cars["lateral_position"] == pytest.approx(1.875 + 3.75 * cars["lane"])
    assert (cars["yaw"] == 0.0).all()
    for name, low, high in (("speed", 30.0, 50.0), ("desired_speed", 80.0, 120.0)):
        speeds = 3.6 * cars[name]
        assert low - 1e-9 <= speeds.min() < low + 0.2
        assert high - 0.2 < speeds.max() <= high
        assert speeds.mean() == pytest.approx((low + high) / 2.0, rel=0.02)
    assert cars["command_position"].min() >= 140.0
    assert cars["command_position"].max() <= 160.0


def test_profiles_and_dispositions_follow_their_mixes():
    overrides = {
        **NO_COMMANDS,
        "drivers": {"mix": {"normal": 2.0, "defensive": 2.0}},
        "followers": {"mix": {"cooperative": 1.0, "adversarial": 3.0}},
    }
    simulator = Simulator("dense", 40, seed=1, overrides=overrides)
    simulator.reset()
    cars = simulator.vehicles[present(simulator)]
    profiles = np.bincount(cars["profile"], minlength=3) / len(cars)
    dispositions = np.bincount(cars["disposition"], minlength=3) / len(cars)
    assert profiles == pytest.approx([0.5, 0.0, 0.5], abs=0.06)
    assert dispositions == pytest.approx([0.25, 0.0, 0.75], abs=0.06)


def test_a_reset_starts_from_a_road_that_carries_traffic():
    simulator = Simulator("paper", 50, seed=4)
    simulator.reset()
    roads = simulator.roads
    assert (roads["step"] == 0).all()
    assert (roads["num_vehicles"] >= 6).all()
    assert len(set(roads["num_vehicles"].tolist())) > 3
    assert simulator.vehicles["position"][present(simulator)].max() > 900.0
    # Vehicles that passed their command position in the warm-up get no command.
    is_past = present(simulator) & (simulator.vehicles["position"] > 160.0)
    assert np.isinf(simulator.vehicles["command_position"][is_past]).all()


def test_the_warm_up_is_as_long_as_the_scenario_says():
    """A longer warm-up has more vehicles, which are further along the road."""
    short = Simulator("paper", 30, overrides={"warmup": [10.0, 10.0]}, seed=0)
    long = Simulator("paper", 30, overrides={"warmup": [40.0, 40.0]}, seed=0)
    short.reset()
    long.reset()
    assert short.vehicles["position"][present(short)].max() < 250.0
    assert long.vehicles["position"][present(long)].max() > 400.0
    assert long.roads["num_entered"].mean() > 2.5 * short.roads["num_entered"].mean()


@pytest.mark.parametrize(
    ("ahead", "entering", "needed"),
    # s* = s0 + 10 m/s T at equal speeds: 15 m for a car, 22 m for a truck; and half of each length.
    [(0, 0, 19.8), (TRUCK, 0, 25.65), (0, TRUCK, 32.65), (TRUCK, TRUCK, 38.5)],
)
def test_who_enters_keeps_its_gap_to_the_tail_of_the_vehicle_ahead(ahead, entering, needed):
    for place, is_free in ((needed - 0.01, False), (needed + 0.01, True)):
        overrides = {**NO_COMMANDS, **MIXED, "warmup": [0.0, 0.0]}
        simulator = Simulator("paper", overrides=overrides, seed=0)
        simulator.reset()
        # Free roads and speeds as desired: the vehicle ahead keeps its speed.
        keeping = {"speed": 10.0, "desired_speed": 10.0, "profile": ahead}
        stage(simulator, {"lane": 1, "position": place - 1.0, **keeping})
        lane = simulator.state.lanes[0, 1:2]
        lane["next_departure"], lane["next_speed"], lane["next_profile"] = -1.0, 10.0, entering
        simulator.step()
        assert simulator.vehicles[0, 0]["position"] == pytest.approx(place)
        assert (simulator.roads["num_vehicles"][0] == 2) == is_free
        if is_free:
            low, high = (80.0, 90.0) if entering == TRUCK else (80.0, 120.0)
            assert low <= 3.6 * simulator.vehicles[0, 1]["desired_speed"] <= high


def test_every_profile_has_its_range_of_desired_speeds():
    overrides = {**NO_COMMANDS, **MIXED}
    simulator = Simulator("dense", 20, seed=1, overrides=overrides)
    simulator.reset()
    cars = simulator.vehicles[present(simulator)]
    for profile, low, high in ((0, 80.0, 120.0), (TRUCK, 80.0, 90.0)):
        speeds = 3.6 * cars["desired_speed"][cars["profile"] == profile]
        assert speeds.size > 100
        assert low - 1e-9 <= speeds.min() < low + 1.0
        assert high - 1.0 < speeds.max() <= high
