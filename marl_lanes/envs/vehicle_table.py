"""All vehicles of a road as one table of numbers: PettingZoo's ``state``, TorchRL's ``state``."""

import numpy as np
from numpy.typing import NDArray

from marl_lanes.scenario import Scenario
from marl_lanes.traffic.machine.state import NONE
from marl_lanes.traffic.roles.role import Bounds
from marl_lanes.traffic.simulator import Simulator

_BOUNDS = {
    "position": (-100.0, 1e5),
    "lateral_position": (-100.0, 200.0),
    "speed": (0.0, 150.0),
    "acceleration": (-20.0, 20.0),
    "yaw": (-100.0, 100.0),
    "yaw_rate": (-150.0, 150.0),
}
"""Lowest and highest values; those beyond them are told as the bound, as in an observation."""

STATE_COLUMNS = (*_BOUNDS, "agent")
"""Columns of the table: fields of VEHICLE; ``agent`` says which agent the vehicle is, -1 if it is
none: by the serial number of its command in PettingZoo's, by its slot in TorchRL's."""

_LOW, _HIGH = np.asarray([*_BOUNDS.values()], np.float32).T


def state_bounds(scenario: Scenario, num_agents: int) -> Bounds:
    """Lowest and highest tables, two (max_vehicles, columns) float32.

    Args:
        scenario: of the road.
        num_agents: the numbers in the column ``agent`` are below it.
    """
    shape = (scenario.max_vehicles, len(STATE_COLUMNS))
    low, high = np.append(_LOW, NONE), np.append(_HIGH, num_agents - 1)
    return (
        np.broadcast_to(low.astype(np.float32), shape),
        np.broadcast_to(high.astype(np.float32), shape),
    )


def read_vehicle_table(simulator: Simulator) -> NDArray[np.float32]:
    """The vehicles of the first road by decreasing position, then rows of zeros with agent -1.

    Returns:
        (max_vehicles, columns) float32.
    """
    rows = np.zeros((simulator.scenario.max_vehicles, len(STATE_COLUMNS)), np.float32)
    count = int(simulator.roads["num_vehicles"][0])
    cars = simulator.vehicles[0, simulator.state.order[0, :count]]
    for column, name in enumerate(_BOUNDS):
        rows[:count, column] = cars[name]
    rows[:, :-1].clip(_LOW, _HIGH, out=rows[:, :-1])
    commands = simulator.agents["command"][0, cars["agent"]]
    rows[:count, -1] = np.where(cars["agent"] == NONE, NONE, commands)
    rows[count:, -1] = NONE
    return rows


def read_vehicle_tables(simulator: Simulator) -> NDArray[np.float32]:
    """The same of every road, with the agents' slots.

    Returns:
        (E, max_vehicles, columns) float32.
    """
    order, count = simulator.state.order, simulator.roads["num_vehicles"]
    is_there = np.arange(order.shape[1]) < count[:, None]
    slots = np.where(is_there, order, 0)
    rows = np.empty((*order.shape, len(STATE_COLUMNS)), np.float32)
    for column, name in enumerate(STATE_COLUMNS):
        rows[..., column] = np.take_along_axis(simulator.vehicles[name], slots, axis=1)
    rows[..., :-1].clip(_LOW, _HIGH, out=rows[..., :-1])
    rows[~is_there] = [0.0] * (len(STATE_COLUMNS) - 1) + [NONE]
    return rows
