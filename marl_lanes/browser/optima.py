"""The optimum of each recorded maneuver, to be drawn beside the driven one."""

from collections.abc import Callable
from typing import Any

import numpy as np

from marl_lanes.evaluation.measures import STEERING_COSTS
from marl_lanes.evaluation.optimum import find_unminimised, optimal_lane_change
from marl_lanes.scenario import Scenario
from marl_lanes.traffic.machine.state import Outcome
from marl_lanes.trajectory.events import Command, find_commands
from marl_lanes.trajectory.frames import Rows

_DECIMALS = {
    "position": 3,
    "lateral_position": 4,
    "yaw": 6,
    "yaw_rate": 6,
    "yaw_acceleration": 5,
}
"""What is kept of the optimum's path, in the units of the trajectory's columns."""


def find_optima(
    rows: Rows, scenario: Scenario, *, progress: Callable[[int], object] | None = None
) -> dict[int, dict[str, Any]]:
    """The optimum of every maneuver on one road, or why it has none.

    As in the metrics: the cheapest lane change from the state of the last engagement, at the driven
    speeds.

    Args:
        rows: (N,) ROW of one road.
        scenario: of the road.
        progress: called after every maneuver with the number of those that are done.

    Returns:
        By command, ready for JSON: ``reason``, a text, where there is none; else ``first_step``
        (of the last engagement), ``cost`` of the optimum and ``driven_cost`` of the maneuver since
        that step, ``total_cost`` of the maneuver with its aborts, and the path from that step on:
        ``position``, ``lateral_position``, ``yaw``, ``yaw_rate``, ``yaw_acceleration``, each
        (num_steps + 1,).
    """
    unminimised = find_unminimised(scenario)
    found = {}
    for count, command in enumerate(find_commands(rows), 1):
        if unminimised:
            reason = f"the reward has costs that no optimum minimizes: {', '.join(unminimised)}"
            found[command.command] = {"reason": reason}
        else:
            found[command.command] = _find_optimum(rows, scenario, command)
        if progress is not None:
            progress(count)
    return found


def _find_optimum(rows: Rows, scenario: Scenario, command: Command) -> dict[str, Any]:
    if command.outcome != Outcome.COMPLETED:
        return {"reason": "the change was not completed"}
    if not command.engaged_steps:
        return {"reason": "the change began before the recording"}
    driven = rows[(rows["vehicle"] == command.vehicle) & (rows["command"] == command.command)]
    driven = driven[np.argsort(driven["step"])]
    start = command.engaged_steps[-1]
    (first,) = driven[driven["step"] == start]
    after = driven[driven["step"] > start]
    direction = int(first["direction"])
    try:
        optimum = optimal_lane_change(
            scenario,
            after["speed"],
            deviation=float(first["lateral_deviation"]),
            yaw=direction * float(first["yaw"]),
            yaw_rate=direction * float(first["yaw_rate"]),
            direction=direction,
            initial_speed=float(first["speed"]),
            position=float(first["position"]),
            lateral_position=float(first["lateral_position"]),
        )
    except (ValueError, RuntimeError) as error:
        return {"reason": f"none was found: {error}"}
    return {
        "first_step": start,
        "cost": round(-optimum.total_return, 5),
        "driven_cost": _steering_cost(after),
        "total_cost": _steering_cost(driven),
        **{
            name: np.round(optimum.path[name], decimals).tolist()
            for name, decimals in _DECIMALS.items()
        },
    }


def _steering_cost(rows: Rows) -> float:
    total = sum(np.nansum(rows[f"reward_{name}"], dtype=np.float64) for name in STEERING_COSTS)
    return round(-float(total), 5)
