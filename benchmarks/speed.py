"""Speed of one environment and of a batch, beside highway-env in the same run.

python benchmarks/speed.py [--rounds N] [--json FILE]

The contestants take turns (A B C A B C ...), a second or so each; the table shows the median of the
rounds. highway-env is in the extra ``benchmark``; without it its row is missing.
"""

import argparse
import importlib.util
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

from marl_lanes import LaneChangeEnv, Simulator, parallel_env

SECONDS = 1.5
"""How long each contestant runs in a round."""
NUM_ENVS = 1024
HIGHWAY_VEHICLES = 20

Contestant = Callable[[], tuple[float, float]]
"""Runs for about SECONDS; gives environment steps and vehicle steps per second."""


def make_pettingzoo() -> Contestant:
    """The loop that a user writes: dicts in, dicts out."""
    env = parallel_env("paper")
    zero = np.zeros(1, np.float32)
    roads = env.simulator.roads
    env.reset(seed=0)

    def run() -> tuple[float, float]:
        steps = vehicles = 0
        start = time.perf_counter()
        while (elapsed := time.perf_counter() - start) < SECONDS:
            if not env.agents:
                env.reset()
            for _ in range(50):
                before = int(roads["step"][0])
                env.step(dict.fromkeys(env.agents, zero))
                steps += 1
                # One step of the environment passes the time steps without an agent, too.
                vehicles += int(roads["num_vehicles"][0]) * (int(roads["step"][0]) - before)
                if not env.agents:
                    break
        return steps / elapsed, vehicles / elapsed

    return run


def make_simulator() -> Contestant:
    """The batch below both environments."""
    simulator = Simulator("paper", NUM_ENVS, overrides={"num_agents": None, "horizon": None})
    simulator.reset()
    return _batched(lambda: simulator.step(), simulator)


def make_batched(*, learned_followers: bool = False) -> Contestant:
    """LaneChangeEnv.step with zero actions, of the changers alone or of the followers, too."""
    env = LaneChangeEnv(
        "paper",
        NUM_ENVS,
        overrides={"num_agents": None, "horizon": None},
        learned_followers=learned_followers,
    )
    data = env.reset()
    data.update(env.full_action_spec.zero())
    return _batched(lambda: env.step(data), env.simulator)


def _batched(step: Callable[[], Any], simulator: Simulator) -> Contestant:
    def run() -> tuple[float, float]:
        steps, vehicles = 0, 0
        start = time.perf_counter()
        while (elapsed := time.perf_counter() - start) < SECONDS:
            for _ in range(10):
                step()
            steps += 10
            vehicles += 10 * int(simulator.roads["num_vehicles"].sum())
        return steps * simulator.num_envs / elapsed, vehicles / elapsed

    return run


def make_highway_env() -> Contestant:
    """highway-v0 with a continuous action at 10 Hz, zero actions, no rendering."""
    import gymnasium
    import highway_env  # noqa: F401 - registers its environments

    config = {
        "action": {"type": "ContinuousAction"},
        "lanes_count": 3,
        "vehicles_count": HIGHWAY_VEHICLES,
        "simulation_frequency": 10,
        "policy_frequency": 10,
        "duration": 40,
    }
    env = gymnasium.make("highway-v0", config=config)
    env.reset(seed=0)
    zero = np.zeros(2, np.float32)

    def run() -> tuple[float, float]:
        steps = 0
        start = time.perf_counter()
        while (elapsed := time.perf_counter() - start) < SECONDS:
            _, _, terminated, truncated, _ = env.step(zero)
            steps += 1
            if terminated or truncated:
                env.reset()
        return steps / elapsed, steps * (HIGHWAY_VEHICLES + 1) / elapsed

    return run


def measure_start() -> dict[str, float]:
    """Seconds of a first import, and of a first reset and step, in a fresh interpreter."""
    program = (
        "import time; a = time.perf_counter(); import marl_lanes; b = time.perf_counter()\n"
        "env = marl_lanes.parallel_env('paper'); env.reset(seed=0)\n"
        "env.step({agent: [0.0] for agent in env.agents}); c = time.perf_counter()\n"
        "print(b - a, c - b)"
    )
    result = {}
    with tempfile.TemporaryDirectory() as cache:
        for name in ("cold", "warm"):
            environment = {**os.environ, "NUMBA_CACHE_DIR": cache}
            output = subprocess.run(
                [sys.executable, "-c", program],
                env=environment,
                check=True,
                capture_output=True,
                text=True,
            ).stdout
            seconds = [float(value) for value in output.split()]
            result[f"{name}_import_seconds"], result[f"{name}_first_step_seconds"] = seconds
    return result


def main() -> None:
    """Run the rounds, print the table, write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5, help="turns of each (default: 5)")
    parser.add_argument("--json", type=Path, help="write the figures to this file as well")
    options = parser.parse_args()
    torch.set_num_threads(1)
    contestants = {
        "parallel_env, one road": make_pettingzoo(),
        f"Simulator, {NUM_ENVS} roads": make_simulator(),
        f"LaneChangeEnv, {NUM_ENVS} roads": make_batched(),
        "  with learned followers": make_batched(learned_followers=True),
    }
    if importlib.util.find_spec("highway_env") is not None:
        contestants[f"highway-env, {HIGHWAY_VEHICLES} vehicles"] = make_highway_env()
    for run in contestants.values():
        run()
    rounds: dict[str, list[tuple[float, float]]] = {name: [] for name in contestants}
    for _ in range(options.rounds):
        for name, run in contestants.items():
            rounds[name].append(run())
    table = {
        name: {
            "steps_per_second": statistics.median(row[0] for row in rows),
            "vehicle_steps_per_second": statistics.median(row[1] for row in rows),
        }
        for name, rows in rounds.items()
    }
    start = measure_start()
    print(f"{'':28} {'steps/s':>14} {'vehicle-steps/s':>16}")
    for name, row in table.items():
        print(
            f"{name:28} {row['steps_per_second']:14,.0f} {row['vehicle_steps_per_second']:16,.0f}"
        )
    for name, seconds in start.items():
        print(f"{name:28} {seconds:14.2f}")
    if options.json is not None:
        options.json.write_text(json.dumps({**table, **start}, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
