"""The occupancy grid around a changer."""

import pytest
from staging import MIXED, TRUCK, command, simulator_of, stage

from marl_lanes.scenario import ScenarioError, load_scenario
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.traffic.roles.grid import grid_columns

GRID = {"num_lanes": 3, "num_stretches": 4, "stretch": 5.0}


def test_its_columns_are_behind_the_features_in_every_step():
    fields = {"features": ["yaw"], "grid": GRID, "num_stacked": 2}
    scenario = load_scenario("paper", {"observation": fields})
    names = [column.name for column in CHANGER.seen(scenario)]
    cells = [f"{lane}_{stretch}" for lane in range(3) for stretch in range(4)]
    one = ["yaw", *(f"occupied_{c}" for c in cells), *(f"cell_speed_{c}" for c in cells)]
    assert names == one + [f"{name}@1" for name in one]
    assert len(grid_columns(scenario)) == 24
    assert grid_columns(load_scenario("paper")) == []
    low, high = CHANGER.observation_bounds(scenario)
    assert low[1:13].tolist() == [0.0] * 12
    assert high[13:25].tolist() == [150.0] * 12


@pytest.mark.parametrize("direction", [1, -1])
def test_a_vehicle_is_in_every_cell_that_its_body_overlaps(direction):
    simulator = simulator_of(observation={"features": ["yaw"], "grid": GRID})
    still = {"speed": 0.0, "desired_speed": 1.0}
    stage(
        simulator,
        {"lane": 1, "position": 100.0, **still},
        # Its body of 5 m is from 7 m to 12 m behind, so from the end of the last stretch on.
        {"lane": 1 + direction, "position": 90.5, **still},
        {"lane": 1 - direction, "position": 103.0, **still},
        {"lane": 1, "position": 300.0, **still},
    )
    agent = command(simulator, 0, direction)
    simulator.step()
    cars = simulator.vehicles[0]
    occupied, speed = simulator.state.observations[0, agent, 1:].reshape(2, 3, 4)
    # Rows: away from the target side, the own lane, the target lane; from the rear to the front.
    assert occupied.tolist() == [[0, 0, 1, 1], [0, 0, 0, 0], [1, 0, 0, 0]]
    assert speed[2, 0] == pytest.approx(cars["speed"][1] - cars["speed"][0], abs=1e-6)
    assert speed[0, 2] == speed[0, 3] != 0.0
    assert not speed[occupied == 0].any()


def test_a_truck_is_in_more_cells_than_a_car():
    simulator = simulator_of(**MIXED, observation={"features": ["yaw"], "grid": GRID})
    still = {"speed": 0.0, "desired_speed": 0.01}
    stage(
        simulator,
        {"lane": 1, "position": 100.0, **still},
        # Its body of 16.5 m begins 8.25 m behind its centre: 1.25 m behind that of the car.
        {"lane": 2, "position": 107.0, "profile": TRUCK, **still},
    )
    agent = command(simulator, 0, 1)
    simulator.step()
    occupied = simulator.state.observations[0, agent, 1:].reshape(2, 3, 4)[0]
    assert occupied.tolist() == [[0, 0, 0, 0], [0, 0, 0, 0], [0, 1, 1, 1]]


@pytest.mark.parametrize(
    ("grid", "message"),
    [
        ({"num_lanes": 2}, "observation.grid.*num_lanes = 2: must be odd"),
        ({"num_lanes": 9}, "observation.grid.num_lanes = 9"),
        ({"num_stretches": 1}, "observation.grid.num_stretches = 1"),
        ({"stretch": 0.5}, "observation.grid.stretch = 0.5"),
        ({"cells": 3}, "observation.grid.cells: unknown key"),
    ],
)
def test_what_is_no_grid_is_refused(grid, message):
    with pytest.raises(ScenarioError, match=message):
        load_scenario("paper", {"observation": {"grid": grid}})
