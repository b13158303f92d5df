"""All vehicles of a road as one table of numbers: what PettingZoo's ``state`` returns."""

import numpy as np
from numpy.typing import NDArray

from marl_lanes.traffic.machine.state import NONE
from marl_lanes.traffic.simulator import Simulator

STATE_COLUMNS = (
    "position",
    "lateral_position",
    "speed",
    "acceleration",
    "yaw",
    "yaw_rate",
    "agent",
)
"""Columns of the table: fields of VEHICLE; ``agent`` is the serial number of the vehicle's command,
-1 if it has none."""


def read_vehicle_table(simulator: Simulator) -> NDArray[np.float32]:
    """The vehicles of the first road by decreasing position, then rows of zeros with agent -1.

    Returns:
        (max_vehicles, columns) float32.
    """
    rows = np.zeros((simulator.scenario.max_vehicles, len(STATE_COLUMNS)), np.float32)
    count = int(simulator.roads["num_vehicles"][0])
    cars = simulator.vehicles[0, simulator.state.order[0, :count]]
    for column, name in enumerate(STATE_COLUMNS[:-1]):
        rows[:count, column] = cars[name]
    commands = simulator.agents["command"][0, cars["agent"]]
    rows[:count, -1] = np.where(cars["agent"] == NONE, NONE, commands)
    rows[count:, -1] = NONE
    return rows
