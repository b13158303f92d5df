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
    "length": (0.0, 20.0),
    "width": (0.0, 2.6),
}
"""Lowest and highest values; those beyond them are told as the bound, as in an observation."""

_SIZE = ("length", "width")


def state_columns(scenario: Scenario) -> tuple[str, ...]:
    """Columns of the table: fields of VEHICLE, then ``length`` and ``width`` if there are several.

    The last one, ``agent``, says which agent the vehicle is, -1 if it is none: by the serial number
    of its command in PettingZoo's, by its slot in TorchRL's. An agent whose command ended in the
    last step is told, too, as its last observation is.
    """
    bodies = {scenario.body_of(name) for name in scenario.drivers.driven}
    shown = [name for name in _BOUNDS if name not in _SIZE or len(bodies) > 1]
    return (*shown, "agent")


def _number_bounds(scenario: Scenario) -> NDArray[np.float32]:
    """Lowest and highest numbers of all columns but the last, (2, columns - 1)."""
    columns = state_columns(scenario)[:-1]
    return np.asarray([_BOUNDS[name] for name in columns], np.float32).T


def _read_column(simulator: Simulator, cars: NDArray[np.void], name: str) -> NDArray[np.float64]:
    if name in _SIZE:
        half = simulator.parameters.profiles[f"half_{name}"]
        return np.asarray(2.0 * half[cars["profile"]])
    return np.asarray(cars[name])


def _find_slots(simulator: Simulator) -> NDArray[np.int64]:
    """The slot of each vehicle's agent, or NONE, (E, V)."""
    slots = simulator.vehicles["agent"].copy()
    envs, ended = np.nonzero(simulator.has_ended)
    slots[envs, simulator.agents["vehicle"][envs, ended]] = ended
    return slots


def state_bounds(scenario: Scenario, num_agents: int) -> Bounds:
    """Lowest and highest tables, two (max_vehicles, columns) float32.

    Args:
        scenario: of the road.
        num_agents: the numbers in the column ``agent`` are below it.
    """
    shape = (scenario.max_vehicles, len(state_columns(scenario)))
    numbers = _number_bounds(scenario)
    low, high = np.append(numbers[0], NONE), np.append(numbers[1], num_agents - 1)
    return (
        np.broadcast_to(low.astype(np.float32), shape),
        np.broadcast_to(high.astype(np.float32), shape),
    )


def read_vehicle_table(simulator: Simulator) -> NDArray[np.float32]:
    """The vehicles of the first road by decreasing position, then rows of zeros with agent -1.

    Returns:
        (max_vehicles, columns) float32.
    """
    columns = state_columns(simulator.scenario)
    rows = np.zeros((simulator.scenario.max_vehicles, len(columns)), np.float32)
    count = int(simulator.roads["num_vehicles"][0])
    order = simulator.state.order[0, :count]
    cars, slots = simulator.vehicles[0, order], _find_slots(simulator)[0, order]
    for column, name in enumerate(columns[:-1]):
        rows[:count, column] = _read_column(simulator, cars, name)
    rows[:, :-1].clip(*_number_bounds(simulator.scenario), out=rows[:, :-1])
    commands = simulator.agents["command"][0, slots]
    rows[:count, -1] = np.where(slots == NONE, NONE, commands)
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
    columns = state_columns(simulator.scenario)
    rows = np.empty((*order.shape, len(columns)), np.float32)
    values = [_read_column(simulator, simulator.vehicles, name) for name in columns[:-1]]
    for column, value in enumerate([*values, _find_slots(simulator)]):
        rows[..., column] = np.take_along_axis(value, slots, axis=1)
    rows[..., :-1].clip(*_number_bounds(simulator.scenario), out=rows[..., :-1])
    rows[~is_there] = [0.0] * (len(columns) - 1) + [NONE]
    return rows
