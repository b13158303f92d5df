"""The occupancy grid around a changer: which cells have a vehicle in them, and how fast it is."""

import math
from typing import Any

from marl_lanes.scenario import Scenario
from marl_lanes.traffic.machine.compiled import internal
from marl_lanes.traffic.roles.role import Column


def grid_columns(scenario: Scenario) -> list[Column]:
    """The grid's columns: all cells' occupancy, then all cells' speeds.

    Cells are in the order of lanes, away from the target side first, and of stretches from the
    rear; ``occupied_1_9`` is stretch 9 of lane 1. Without a grid there are none.
    """
    grid = scenario.observation.grid
    if grid is None:
        return []
    cells = [f"{i}_{j}" for i in range(grid.num_lanes) for j in range(grid.num_stretches)]
    occupied = ("1", 0.0, 1.0, 0.0, 1.0, "1 where a body is in the cell, else 0")
    speed = ("m/s", 0.0, 5.0, -150.0, 150.0, "its speed minus the own; 0 in an empty cell")
    return [
        *(Column(f"occupied_{cell}", *occupied) for cell in cells),
        *(Column(f"cell_speed_{cell}", *speed) for cell in cells),
    ]


@internal
def observe_grid(seen: Any, agent: Any, car: Any, scene: Any) -> None:
    """Set the grid's columns; a vehicle is in each cell that its body overlaps.

    The middle lane is the agent's origin lane, and the stretches have its centre in the middle.
    """
    constants = scene.constants
    num_lanes, num_stretches = constants.grid_lanes, constants.grid_stretches
    num_cells = num_lanes * num_stretches
    seen[:] = 0.0
    size = constants.grid_stretch
    start = car.position - 0.5 * num_stretches * size
    for rank in range(scene.road.num_vehicles):
        slot = scene.order[rank]
        other = scene.vehicles[slot]
        half = scene.profiles[other.profile].half_length
        first = math.floor((other.position - half - start) / size)
        last = math.floor((other.position + half - start) / size)
        if slot == agent.vehicle or last < 0 or first >= num_stretches:
            continue
        relative_speed = min(max(other.speed - car.speed, -150.0), 150.0)
        for lane in range(other.lane_low, other.lane_high + 1):
            row = agent.direction * (lane - agent.origin_lane) + num_lanes // 2
            if row < 0 or row >= num_lanes:
                continue
            for stretch in range(max(first, 0), min(last, num_stretches - 1) + 1):
                cell = row * num_stretches + stretch
                seen[cell] = 1.0
                seen[num_cells + cell] = relative_speed
