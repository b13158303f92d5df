"""Batches: vehicle-steps/s of LaneChangeEnv and of the simulator, compared with a bare kernel.

python benchmarks/batched_env.py [--rounds N] [--json FILE]

The limit (limit.py) does only the necessary work of a step, on the same number of roads and
vehicles. In each row the contestants take turns (A B A B ...) and the table shows medians. ``cost``
is the simulator's time per vehicle-step. Separate rounds compare it over the numbers of roads, and
over the numbers of vehicles.
"""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from limit import Limit
from peers import is_installed, make_sumo
from turns import (
    Contestant,
    Rate,
    median,
    median_ratio,
    print_target,
    read_options,
    take_turns,
)

from marl_lanes import LaneChangeEnv, Simulator
from marl_lanes.files import write_json
from marl_lanes.traffic.machine.threads import count_processors

SECONDS = 0.4
"""[s] Length of a turn."""
ENVS = (1, 8, 64, 512, 1024, 2048, 8192)
ENDLESS: dict[str, Any] = {"num_agents": None, "horizon": None}
DENSITIES = (10, 25, 50, 100, 200)
"""Vehicles on a road of 5 km."""
_CROSSING = 180.0
"""[s] Approximate time of a vehicle on 5 km."""


def make_limit(num_envs: int, num_vehicles: int, num_threads: int, length: float) -> Contestant:
    """The bare kernel."""
    roads = Limit(num_envs, num_vehicles, road_length=length)
    bounds = np.linspace(0, num_envs, num_threads + 1).astype(int).tolist()
    (first, *others) = list(pairwise(bounds))
    pool = ThreadPoolExecutor(max(1, num_threads - 1))

    def step() -> None:
        pending = [pool.submit(roads.advance, *bounds) for bounds in others]
        roads.advance(*first)
        for future in pending:
            future.result()

    return _steps(step, lambda: num_vehicles * num_envs, num_envs)


def make_simulator(num_envs: int, num_threads: int, overrides: Mapping[str, Any]) -> Contestant:
    """The simulator, on which both environments are built."""
    simulator = Simulator("paper", num_envs, num_threads=num_threads, overrides=overrides, seed=0)
    simulator.reset()
    return _steps(simulator.step, lambda: int(simulator.roads["num_vehicles"].sum()), num_envs)


def make_env(
    num_envs: int,
    num_threads: int,
    overrides: Mapping[str, Any],
    *,
    scenario: str = "paper",
    learned_followers: bool = False,
) -> Contestant:
    """LaneChangeEnv.step with zero actions."""
    env = LaneChangeEnv(
        scenario,
        num_envs,
        num_threads=num_threads,
        overrides=overrides,
        learned_followers=learned_followers,
        seed=0,
    )
    data = env.reset()
    data.update(env.full_action_spec.zero())
    roads = env.simulator.roads

    def step() -> None:
        env.step(data)
        # As in a rollout: a step merges an old "next" into the new one, which takes time.
        del data["next"]

    return _steps(step, lambda: int(roads["num_vehicles"].sum()), num_envs)


def _steps(step: Callable[[], Any], count: Callable[[], int], num_envs: int) -> Contestant:
    steps = max(2, 2000 // num_envs)

    def advance() -> Rate:
        for _ in range(steps):
            step()
        return Rate(steps * num_envs, steps * count())

    return advance


def density_overrides(num_vehicles: int) -> dict[str, Any]:
    """5 km with about ``num_vehicles``, warmed up until the first vehicles have crossed it."""
    mean = 3 * _CROSSING / num_vehicles
    return {
        **ENDLESS,
        "road": {"length": 5000.0},
        "departures": {"interval": [0.9 * mean, 1.1 * mean]},
        "max_vehicles": 2 * num_vehicles + 16,
        "num_slots": 16,
        "warmup": [1.3 * _CROSSING, 1.5 * _CROSSING],
    }


def run_row(
    label: str, contestants: Mapping[str, Contestant], rounds: int, figures: dict[str, object]
) -> dict[str, list[Rate]]:
    """Run the turns of one row, print it and add it to ``figures``."""
    rates = take_turns(contestants, rounds, SECONDS)
    rows = {name: median(values).vehicle_steps for name, values in rates.items()}
    cost = 1e9 / rows["simulator"]
    shown = "".join(f"{value / 1e6:12.2f}" for value in rows.values())
    print(f"{label:26}{shown}{cost:10.1f}", flush=True)
    figures[label] = {**rows, "nanoseconds": cost}
    return rates


def main() -> None:
    """Run the rows, print the table and the targets, write the JSON."""
    options = read_options(__doc__ or "", rounds=5)
    torch.set_num_threads(1)
    figures: dict[str, object] = {"rounds": options.rounds}
    kept: dict[int, dict[str, list[Rate]]] = {}
    print(f"{'million vehicle-steps/s':26}{'limit':>12}{'simulator':>12}{'env':>12}{'cost':>10} ns")
    for num_threads in range(1, min(2, count_processors()) + 1):
        for num_envs in ENVS:
            if num_envs < num_threads:
                continue
            contestants = {
                "limit": make_limit(num_envs, 16, num_threads, 1000.0),
                "simulator": make_simulator(num_envs, num_threads, ENDLESS),
                "env": make_env(num_envs, num_threads, ENDLESS),
            }
            label = f"{num_envs} roads, {num_threads} threads"
            rates = run_row(label, contestants, options.rounds, figures)
            if num_threads == 1:
                kept[num_envs] = rates
    for num_vehicles in DENSITIES:
        overrides = density_overrides(num_vehicles)
        contestants = {
            "limit": make_limit(64, num_vehicles, 1, 5000.0),
            "simulator": make_simulator(64, 1, overrides),
            "env": make_env(64, 1, overrides),
        }
        run_row(f"64 roads, {num_vehicles} vehicles", contestants, options.rounds, figures)
    print_targets(kept, options.rounds, figures)
    compare_groups(options.rounds, figures)
    if options.json is not None:
        write_json(options.json, figures)


def print_targets(
    kept: Mapping[int, dict[str, list[Rate]]], rounds: int, figures: dict[str, object]
) -> None:
    """Print the figures that have a target, with it."""
    for num_envs, rates in kept.items():
        if num_envs < 64:
            continue
        share = median_ratio(rates["simulator"], rates["limit"], "vehicle_steps")
        print_target(f"share of the limit, {num_envs} roads", share, 0.5)
    times = median_ratio(kept[1024]["simulator"], kept[1024]["env"], "steps")
    print_target("time of LaneChangeEnv.step over simulator's", times, 1.5, is_least=False)
    for axis, sizes in (
        ("64 to 8192 roads", [(e, ENDLESS) for e in ENVS if e >= 64]),
        ("10 to 200 vehicles", [(64, density_overrides(v)) for v in DENSITIES]),
    ):
        spread = find_spread([make_simulator(e, 1, overrides) for e, overrides in sizes], rounds)
        print_target(f"cost, highest over lowest, {axis}", spread, 1.25, is_least=False)
        figures[f"spread, {axis}"] = spread
    if is_installed("libsumo"):
        contestants = {
            "libsumo": make_sumo()[0],
            "simulator": make_simulator(1024, count_processors(), ENDLESS),
        }
        rates = take_turns(contestants, rounds, SECONDS)
        factor = median_ratio(rates["simulator"], rates["libsumo"], "vehicle_steps")
        print_target("simulator, all threads, over libsumo", factor, 100.0)
        figures["ratio to libsumo"] = factor


def find_spread(contestants: Sequence[Contestant], rounds: int) -> float:
    """Largest over smallest time per vehicle-step, each relative to the first contestant's."""
    rates = take_turns({str(place): one for place, one in enumerate(contestants)}, rounds, SECONDS)
    costs = [median_ratio(rates["0"], values, "vehicle_steps") for values in rates.values()]
    return max(costs) / min(costs)


def compare_groups(rounds: int, figures: dict[str, object]) -> None:
    """Compare the environment with followers as a second group of agents and without them."""
    groups = {"changers": False, "changers and followers": True}
    contestants = {
        label: make_env(1024, 1, ENDLESS, scenario="dense", learned_followers=has_followers)
        for label, has_followers in groups.items()
    }
    rates = take_turns(contestants, rounds, SECONDS)
    ratio = median_ratio(rates["changers"], rates["changers and followers"], "steps")
    print(f"time of a step with both groups over changers alone, dense, 1024 roads: {ratio:.2f}")
    figures["both groups over changers alone"] = ratio


if __name__ == "__main__":
    main()
