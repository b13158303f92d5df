"""One environment: ours compared with highway-env, libsumo and VMAS, with equal traffic.

python benchmarks/single_env.py [--rounds N] [--json FILE]

The contestants take turns (A B C A B C ...); the table shows the medians of the rounds. Ours is an
ordinary user loop with dicts, with the resets and their warm-up, on the scenario ``paper``: 1000 m,
three lanes, a departure every 5 to 10 s in each. Our env step ends when an agent is live again;
``vehicle-steps`` counts every time step.
"""

import statistics

import numpy as np
import torch
from peers import is_installed, make_highway_env, make_sumo, make_vmas
from turns import (
    Contestant,
    Rate,
    median,
    median_ratio,
    print_target,
    read_options,
    take_turns,
)

from marl_lanes import Simulator, parallel_env
from marl_lanes.files import write_json

SECONDS = 1.0
"""[s] Length of a turn."""
VMAS_AGENTS = 20
"""The largest number that its scenario allows."""


def make_pettingzoo() -> Contestant:
    """An ordinary user loop, with actions of zero."""
    env = parallel_env("paper", seed=0)
    zero = np.zeros(1, np.float32)
    roads = env.simulator.roads
    env.reset(seed=0)

    def advance() -> Rate:
        passed = 0
        for _ in range(20):
            before = int(roads["step"][0])
            if not env.agents:
                env.reset()
                before = -750  # the mean warm-up, 60 to 90 s
            env.step(dict.fromkeys(env.agents, zero))
            passed += int(roads["step"][0]) - before
        return Rate(20, passed * int(roads["num_vehicles"][0]))

    return advance


def measure_traffic() -> int:
    """Mean number of vehicles on the paper's road, rounded."""
    simulator = Simulator("paper", 64, overrides={"num_agents": None, "horizon": None}, seed=0)
    simulator.reset()
    counts = []
    for _ in range(200):
        simulator.step()
        counts.append(float(simulator.roads["num_vehicles"].mean()))
    return round(statistics.mean(counts))


def main() -> None:
    """Run the rounds, print the table, write the JSON."""
    options = read_options(__doc__ or "", rounds=5)
    torch.set_num_threads(1)
    num_vehicles = measure_traffic()
    contestants = {"parallel_env": make_pettingzoo()}
    if is_installed("libsumo"):
        contestants["libsumo, bare"], contestants["libsumo, four reads"] = make_sumo()
    if is_installed("highway_env"):
        contestants["highway-env"] = make_highway_env(num_vehicles)
    if is_installed("vmas"):
        contestants["VMAS road_traffic"] = make_vmas(VMAS_AGENTS)
    rates = take_turns(contestants, options.rounds, SECONDS)
    print(f"{num_vehicles} vehicles on the paper's road in the mean; {options.rounds} rounds")
    print(f"{'':22} {'env steps/s':>14} {'vehicle-steps/s':>16} {'vehicles':>9}")
    figures: dict[str, object] = {"vehicles": num_vehicles, "rounds": options.rounds}
    for name, rows in rates.items():
        row = median(rows)
        vehicles = "" if name == "parallel_env" else f"{row.vehicle_steps / row.steps:9.1f}"
        print(f"{name:22} {row.steps:14,.0f} {row.vehicle_steps:16,.0f} {vehicles}")
        figures[name] = row._asdict()
    targets = {"libsumo, bare": 1.0, "libsumo, four reads": 1.0, "highway-env": 300.0}
    ours = rates["parallel_env"]
    for name, bound in targets.items():
        if name in rates:
            value = median_ratio(ours, rates[name], "steps")
            print_target(f"env steps/s of parallel_env over {name}", value, bound)
            figures[f"ratio to {name}"] = {"value": value, "target": bound}
    if options.json is not None:
        write_json(options.json, figures)


if __name__ == "__main__":
    main()
