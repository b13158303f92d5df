"""Lane keeping, on straight roads and through arcs."""

import numpy as np
import pytest
from staging import advance, place

from marl_lanes.scenario import ScenarioError, load_scenario
from marl_lanes.traffic.simulator import Simulator

NO_COMMANDS = {"command": {"probability": 0.0}}


@pytest.mark.parametrize("radius", [500.0, -500.0])
def test_lane_keeping_holds_the_centre_through_an_arc(radius):
    arcs = [{"start": 150.0, "end": 850.0, "radius": radius, "transition": 0.0}]
    simulator = Simulator("paper", 2, overrides={**NO_COMMANDS, "road": {"arcs": arcs}}, seed=0)
    simulator.reset()
    largest = settled = 0.0
    for _ in range(600):
        simulator.step()
        cars = simulator.vehicles[simulator.vehicles["id"] >= 0]
        error = np.abs(cars["lateral_position"] - 3.75 * (cars["lane"] + 0.5))
        largest = max(largest, error.max())
        # Seven seconds at 33 m/s after the beginning of the arc.
        is_far_in = (cars["position"] > 400.0) & (cars["position"] < 850.0)
        settled = max(settled, error[is_far_in].max(initial=0.0))
    assert 0.05 < largest < 0.25
    assert settled < 0.02


@pytest.mark.parametrize("speed", [5.0, 15.0, 35.0])
@pytest.mark.parametrize("lateral", [1.0, 3.0])
def test_lane_keeping_returns_to_the_centre(speed, lateral):
    simulator = Simulator("paper", seed=0)
    car = place(simulator, speed=speed, lateral_position=lateral, yaw=0.02, yaw_rate=0.02)
    for _ in range(150):
        advance(simulator, car)
        assert abs(car["yaw_acceleration"]) <= 0.5
    assert car["lateral_position"] == pytest.approx(1.875, abs=1e-3)
    assert car["yaw"] == pytest.approx(0.0, abs=1e-4)


@pytest.mark.parametrize("time_step", [0.01, 0.1, 0.125, 0.2, 0.3, 0.5])
@pytest.mark.parametrize("pole", [0.2, 1.5, 2.5, 3.0])
def test_lane_keeping_is_stable_or_refused(pole, time_step):
    fields = {
        "time_step": time_step,
        "lane_keeping": {"pole": pole, "max_yaw_acceleration": 5.0},
        **NO_COMMANDS,
    }
    if pole * time_step > 0.5:
        with pytest.raises(ScenarioError, match=r"lane_keeping\.pole"):
            load_scenario("paper", fields)
        return
    scenario = load_scenario("paper", fields)
    simulator = Simulator(scenario, seed=0)
    car = place(simulator, lateral_position=1.875 + 0.1)
    for _ in range(round(15.0 / (pole * time_step))):
        advance(simulator, car)
    assert abs(car["lateral_position"] - 1.875) < 0.01
