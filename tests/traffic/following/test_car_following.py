"""The law between two vehicles: after a cut-in, in equilibrium, on a free road."""

import math

import pytest
from staging import simulator_of, stage

from marl_lanes.traffic.simulator import Simulator


def cut_in(form, **more):
    """Accelerations by a law at 25 m/s, 12 m behind a leader at the same speed: both cars."""
    drivers = {"drivers": {"car_following": form, **more}, "warmup": [0.0, 0.0]}
    simulator = Simulator("paper", overrides=drivers, seed=0)
    simulator.reset()
    cruising = {"lane": 1, "speed": 25.0, "desired_speed": 30.0}
    stage(
        simulator,
        {**cruising, "position": 100.0},
        {**cruising, "position": 116.8, "desired_speed": 25.0},
    )
    simulator.step()
    return simulator.vehicles[0]["acceleration"][:2].tolist()


def test_after_a_cut_in_the_acc_model_brakes_less_than_the_idm():
    following, leading = cut_in("acc")
    # The leader at its desired speed keeps it: a_CAH = 0.
    assert leading == pytest.approx(0.0, abs=1e-12)
    wanted = 2.0 * (1.0 - (25.0 / 30.0) ** 4 - (30.0 / 12.0) ** 2)
    assert following == pytest.approx(0.01 * wanted + 0.99 * 1.5 * math.tanh(wanted / 1.5))
    assert cut_in("sum")[0] == -8.0
    assert cut_in("acc", coolness=0.0)[0] == -8.0


def test_the_acc_model_uses_the_leaders_acceleration_of_the_same_step():
    """The leader begins to brake in this step: its last acceleration was 0."""
    drivers = {"drivers": {"car_following": "acc"}, "warmup": [0.0, 0.0]}
    simulator = Simulator("paper", overrides=drivers, seed=0)
    simulator.reset()
    cars = [
        {"lane": 1, "position": 100.0, "speed": 20.0},
        {"lane": 1, "position": 115.0, "speed": 20.0},
        {"lane": 1, "position": 125.0, "speed": 5.0, "desired_speed": 5.0},
    ]
    stage(simulator, *cars)
    simulator.step()
    first, second, _ = simulator.vehicles[0]["acceleration"][:3]
    assert second == -8.0
    gap = 15.0 - 4.8
    wanted = 2.0 * (1.0 - (20.0 / 30.0) ** 4 - (25.0 / gap) ** 2)
    heuristic = 400.0 * -8.0 / (400.0 + 2.0 * gap * 8.0)
    expected = 0.01 * wanted + 0.99 * (heuristic + 1.5 * math.tanh((wanted - heuristic) / 1.5))
    assert expected < -6.0
    assert first == pytest.approx(expected)


def test_behind_an_accelerating_leader_the_desired_speed_is_not_exceeded():
    drivers = {"drivers": {"car_following": "acc"}, "warmup": [0.0, 0.0]}
    simulator = Simulator("paper", overrides=drivers, seed=0)
    simulator.reset()
    stage(
        simulator,
        {"lane": 1, "position": 100.0, "speed": 20.0, "desired_speed": 20.0},
        {"lane": 1, "position": 150.0, "speed": 20.0, "desired_speed": 60.0},
    )
    for _ in range(50):
        simulator.step()
        assert simulator.vehicles[0, 0]["speed"] <= 20.0 + 1e-12


@pytest.mark.parametrize("form", ["sum", "acc"])
def test_in_equilibrium_the_acc_model_is_the_idm(form):
    """Steady following: gap (s0 + v T)/sqrt(1 - (v/v0)^4), where both laws give 0."""
    simulator = Simulator(
        "paper",
        overrides={"drivers": {"car_following": form}, "warmup": [0.0, 0.0]},
        seed=0,
    )
    simulator.reset()
    leader = {"lane": 1, "position": 300.0, "speed": 15.0, "desired_speed": 15.0}
    stage(
        simulator,
        leader,
        {"lane": 1, "position": 260.0, "speed": 15.0, "desired_speed": 30.0},
    )
    for _ in range(440):
        simulator.step()
    cars = simulator.vehicles[0]
    assert cars["position"][0] < 1000.0
    gap = cars["position"][0] - cars["position"][1] - 4.8
    assert gap == pytest.approx(20.0 / math.sqrt(1.0 - 0.5**4), rel=1e-3)
    assert cars["acceleration"][1] == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("form", ["max", "sum", "acc"])
def test_alone_on_the_road_a_driver_reaches_the_desired_speed(form):
    simulator = Simulator(
        "paper",
        overrides={
            "drivers": {"car_following": form},
            "departures": {"interval": [500.0, 500.0], "desired_speed": [25.0, 25.0]},
            "command": {"probability": 0.0},
            "road": {"length": 5000.0},
            "warmup": [700.0, 700.0],
        },
        seed=0,
    )
    simulator.reset()
    cars = simulator.vehicles[0][simulator.vehicles[0]["id"] >= 0]
    assert len(cars) > 0
    assert cars["speed"].max() == pytest.approx(25.0, abs=0.01)
    assert (cars["speed"] <= 25.0).all()


@pytest.mark.parametrize("form", ["max", "sum", "acc"])
@pytest.mark.parametrize(
    ("gap", "speed", "expected"),
    # Behind a vehicle that stands: the physical limit, or what stops the driver in the step.
    [(0.0, 10.0, -8.0), (0.0, 0.5, -5.0), (0.0, 0.0, 0.0), (1e-9, 10.0, -8.0)],
)
def test_at_no_gap_the_driver_brakes_at_the_limit(form, gap, speed, expected):
    simulator = simulator_of(drivers={"car_following": form})
    stage(
        simulator,
        {"lane": 1, "position": 104.8 + gap, "speed": 0.0, "desired_speed": 1e-9},
        {"lane": 1, "position": 100.0, "speed": speed},
    )
    simulator.step()
    assert simulator.vehicles[0, 1]["acceleration"] == pytest.approx(expected)
