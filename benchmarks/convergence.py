"""The order of the integration: the error after 8 s as the time step is halved, four times.

python benchmarks/convergence.py [--figure FILE ...] [--json FILE]

Four smooth motions of one vehicle: from rest to its desired speed; behind a leader that drives at a
constant speed; a lane change with given yaw accelerations; lane keeping on an arc. The solution of
the same differential equations is that of scipy's DOP853, written here a second time. The exit code
is 1 if an order is not within 0.1 of ORDER.
"""

import argparse
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from marl_lanes import Simulator
from marl_lanes.files import write_json
from marl_lanes.traffic.machine.state import Phase

ORDER = 1.0
"""Of semi-implicit Euler: it takes the acceleration from the beginning of each step."""
TOLERANCE = 0.1
TIME_STEPS = (0.16, 0.08, 0.04, 0.02, 0.01)
"""[s] Each is half the one before."""
DURATION = 8.0
"""[s] A whole number of every one of them."""

LANE, LENGTH = 3.75, 4.8
A_MAX, BRAKING, S0, HEADWAY = 2.0, 1.5, 5.0, 1.0
POLE = 1.0
"""[rad/s] Of lane keeping: slow enough that it is still at work at the end."""
RADIUS = 300.0
YAW_RATE = 2.0 * math.pi * LANE / (20.0 * DURATION**2)
"""[rad/s] Amplitude with which a vehicle at 20 m/s moves one lane aside in DURATION."""

Car = dict[str, float]
Rate = Callable[[float, NDArray[np.float64]], Sequence[float]]
EMPTY = {"warmup": [0.0, 0.0], "num_agents": None, "horizon": None}


@dataclass(frozen=True)
class Motion:
    """A smooth motion, in the simulation and as differential equations.

    Args:
        name: as the figure has it.
        overrides: of the scenario ``paper``.
        cars: fields of the vehicles at the start, the compared one last.
        rate: the derivative of the state; the compared quantity is its first.
        start: the state at the start.
        compared: the vehicle's field of that quantity.
        action: yaw acceleration by time [rad/s^2] if the vehicle is an agent that is engaged.
    """

    name: str
    overrides: dict[str, Any]
    cars: tuple[Car, ...]
    rate: Rate
    start: tuple[float, ...]
    compared: str
    action: Callable[[float], float] | None = None

    def simulate(self, time_step: float) -> float:
        """The compared quantity after DURATION in the simulation [m]."""
        overrides = EMPTY | self.overrides | {"time_step": time_step}
        simulator = Simulator("paper", seed=0, overrides=overrides)
        simulator.reset()
        simulator.state.lanes["next_departure"] = math.inf
        for slot, car in enumerate(self.cars):
            _put(simulator, slot, car)
        last = len(self.cars) - 1
        if self.action is not None:
            _engage(simulator, last)
        for step in range(round(DURATION / time_step)):
            if self.action is not None:
                simulator.actions[...] = self.action(step * time_step)
            simulator.advance()
        if simulator.roads["num_vehicles"][0] != len(self.cars):
            raise RuntimeError(f"{self.name}: a vehicle has left the road")
        return float(simulator.vehicles[0, last][self.compared])

    def solve(self) -> float:
        """The compared quantity after DURATION by the differential equations [m]."""
        solved = solve_ivp(self.rate, (0.0, DURATION), self.start, "DOP853", rtol=1e-12, atol=1e-12)
        return float(solved.y[0, -1])


def _put(simulator: Simulator, slot: int, car: Car) -> None:
    """Place a vehicle on the first road, behind those that are there."""
    row, road = simulator.vehicles[0][slot], simulator.roads
    row["id"], row["lane"] = slot, 1
    row["lateral_position"], row["command_position"] = 1.5 * LANE, math.inf
    for name, value in car.items():
        row[name] = value
    row["lane_low"] = row["lane_high"] = 1
    row["agent"] = row["changer"] = -1
    simulator.state.order[0, slot] = slot
    road["num_vehicles"] += 1
    road["num_entered"] += 1


def _engage(simulator: Simulator, slot: int) -> None:
    """Make the vehicle an agent that is engaged toward the lane on its left."""
    row = simulator.agents[0][0]
    row["vehicle"], row["phase"], row["command"], row["direction"] = slot, Phase.ENGAGED, 0, 1
    row["origin_lane"], row["target_lane"] = 1, 2
    for name in ("leader", "follower", "target_leader", "target_follower"):
        row[name] = -1
    simulator.vehicles["agent"][0, slot] = 0
    simulator.roads["num_live"] = simulator.roads["num_commands"] = 1


def _accelerate(_: float, state: NDArray[np.float64]) -> Sequence[float]:
    """Position, speed: Eq. 9 on a free road."""
    return state[1], A_MAX * (1.0 - (state[1] / 30.0) ** 4)


def _follow(time: float, state: NDArray[np.float64]) -> Sequence[float]:
    """Position, speed: Eq. 9 behind a leader at 20 m/s, 60 m ahead at the start."""
    position, speed = state
    gap = 160.0 + 20.0 * time - position - LENGTH
    wanted = S0 + speed * (HEADWAY + (speed - 20.0) / (2.0 * math.sqrt(A_MAX * BRAKING)))
    return speed, A_MAX * (1.0 - max((speed / 30.0) ** 4, (wanted / gap) ** 2))


def _steer(time: float) -> float:
    """Yaw acceleration whose integral is one sine of yaw rate."""
    return YAW_RATE * 2.0 * math.pi / DURATION * math.cos(2.0 * math.pi * time / DURATION)


def _change(time: float, state: NDArray[np.float64]) -> Sequence[float]:
    """Lateral position, yaw, yaw rate at 20 m/s."""
    return 20.0 * math.sin(state[1]), state[2], _steer(time)


def _keep(_: float, state: NDArray[np.float64]) -> Sequence[float]:
    """Lateral position, yaw, yaw rate, position at 15 m/s on an arc, with lane keeping."""
    lateral, yaw, yaw_rate, _ = state
    progress = 15.0 * math.cos(yaw) / (1.0 - lateral / RADIUS)
    turning = yaw_rate - progress / RADIUS
    error = 1.5 * LANE - lateral
    steering = POLE**3 * error / 15.0 - 3.0 * POLE**2 * yaw - 3.0 * POLE * turning
    return 15.0 * math.sin(yaw), turning, steering, progress


MOTIONS = (
    Motion(
        "free acceleration",
        {},
        ({"position": 100.0, "speed": 10.0, "desired_speed": 30.0},),
        _accelerate,
        (100.0, 10.0),
        "position",
    ),
    Motion(
        "following a leader",
        {},
        (
            {"position": 160.0, "speed": 20.0, "desired_speed": 20.0},
            {"position": 100.0, "speed": 25.0, "desired_speed": 30.0},
        ),
        _follow,
        (100.0, 25.0),
        "position",
    ),
    Motion(
        "lane change, given actions",
        # It is complete at the very end if at all, so the actions count.
        {"completion": dict.fromkeys(("max_deviation", "max_lateral_speed", "max_yaw_rate"), 1e-3)},
        ({"position": 100.0, "speed": 20.0, "desired_speed": 20.0},),
        _change,
        (1.5 * LANE, 0.0, 0.0),
        "lateral_position",
        _steer,
    ),
    Motion(
        "lane keeping on an arc",
        {
            "road": {"arcs": [{"start": 50.0, "end": 900.0, "radius": RADIUS, "transition": 0.0}]},
            "lane_keeping": {"pole": POLE},
            # Just enough for 15 m/s: lane keeping this slow is not allowed for more.
            "drivers": {"profiles": {"normal": {"comfortable_lateral_acceleration": 0.8}}},
        },
        ({"position": 100.0, "speed": 15.0, "desired_speed": 15.0, "lateral_position": 6.5},),
        _keep,
        (6.5, 0.0, 0.0, 100.0),
        "lateral_position",
    ),
)


def measure(motion: Motion) -> dict[str, Any]:
    """The error at each time step [m], and the order between each two of them."""
    exact = motion.solve()
    errors = [abs(motion.simulate(step) - exact) for step in TIME_STEPS]
    ratios = np.divide(errors[:-1], errors[1:])
    return {"errors": errors, "orders": np.log2(ratios).tolist()}


def draw(results: dict[str, dict[str, Any]], paths: Sequence[Path]) -> None:
    """Draw the errors over the time step, with the slope of ORDER."""
    # Only the figure needs matplotlib.
    from matplotlib.figure import Figure

    from marl_lanes.evaluation.style import GREY, WIDTH, styled, write_figure

    @styled
    def write() -> None:
        figure = Figure(figsize=(WIDTH, 4.2), layout="constrained")
        axes = figure.subplots()
        for name, result in results.items():
            axes.plot(TIME_STEPS, result["errors"], marker="o", label=name)
        slope = np.asarray(TIME_STEPS) / TIME_STEPS[0]
        top = 2.0 * max(result["errors"][0] for result in results.values())
        axes.plot(TIME_STEPS, top * slope, color=GREY, ls=":", label="order 1")
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xticks(TIME_STEPS, [str(step) for step in TIME_STEPS])
        axes.minorticks_off()
        axes.set_title(f"Error after {DURATION:g} s, by time step")
        axes.set_xlabel("time step [s]")
        axes.set_ylabel("error of the position [m]")
        figure.legend(loc="outside lower center", ncols=3)
        write_figure(figure, *paths)

    write()


def main(arguments: list[str] | None = None) -> int:
    """Measure every motion, print the table, draw the figure."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--figure", type=Path, action="append", default=[], help="draw it to this file, too"
    )
    parser.add_argument("--json", type=Path, help="write the figures to this file as well")
    options = parser.parse_args(arguments)
    results = {motion.name: measure(motion) for motion in MOTIONS}
    print(f"error after {DURATION:g} s [m], and order")
    print(f"{'time step [s]':>28}" + "".join(f"{step:10}" for step in TIME_STEPS) + "     order")
    for name, result in results.items():
        errors = "".join(f"{error:10.2e}" for error in result["errors"])
        print(f"{name:>28}{errors}{result['orders'][-1]:10.3f}")
    if options.figure:
        draw(results, options.figure)
    if options.json is not None:
        write_json(options.json, {"time_steps": TIME_STEPS, "motions": results})
    has_order = [abs(result["orders"][-1] - ORDER) <= TOLERANCE for result in results.values()]
    return 0 if all(has_order) else 1


if __name__ == "__main__":
    sys.exit(main())
