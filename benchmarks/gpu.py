"""A GPU: vehicle-steps/s of Simulator and LaneChangeEnv there, beside the CPU's and the limit.

python benchmarks/gpu.py [--json FILE] [--no-tests]

Needs the extra ``gpu``, no network, and about three minutes. After the tables it runs the tests
that hold the roads on the GPU against those on the CPU. The scenario is ``paper`` as recipe fast
trains on it. The limit is the memory: the bytes that a step must read and write, each once, over
the bandwidth of a copy measured here. A step of LaneChangeEnv is timed as it is called, and
replayed as a CUDA graph, which leaves out Python.
"""

import argparse
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from turns import print_target

from marl_lanes import LaneChangeEnv, Simulator
from marl_lanes.files import write_json
from marl_lanes.traffic.machine.threads import count_processors

FAST: dict[str, Any] = {
    "num_agents": None,
    "horizon": None,
    "num_slots": 4,
    "warmup": [40.0, 80.0],
    "command": {"probability": 1.0},
}
"""The training's overrides of recipe fast."""
ENVS = (1024, 8192, 65_536, 262_144)
TESTS = ("tests/traffic/test_gpu.py", "tests/envs/test_gpu_exchange.py")
ROOT = Path(__file__).parents[1]
ROUNDS = 5
# torch.cuda carries no complete types.
cuda: Any = torch.cuda
COPIED = 2**30
"""[bytes]"""


def time_on_gpu(call: Callable[[], object], number: int) -> float:
    """Time of a call in a row of ``number`` [s]: the median of some rows."""
    call()
    times = []
    for _ in range(ROUNDS):
        start, end = (cuda.Event(enable_timing=True) for _ in range(2))
        torch.cuda.synchronize()
        start.record()
        for _ in range(number):
            call()
        end.record()
        torch.cuda.synchronize()
        times.append(float(1e-3 * start.elapsed_time(end) / number))
    return statistics.median(times)


def measure_bandwidth() -> float:
    """Bytes read and written per second by a copy within the GPU's memory."""
    source = torch.empty(COPIED, dtype=torch.uint8, device="cuda")
    target = torch.empty_like(source)
    return 2 * COPIED / time_on_gpu(lambda: target.copy_(source), 10)


def count_bytes(simulator: Simulator) -> float:
    """What a step of a road must read and write: vehicles on it, live agents, the road itself."""
    state, roads = simulator.state, simulator.roads
    vehicles, live = float(roads["num_vehicles"].mean()), float(roads["num_live"].mean())
    per_vehicle = state.vehicles.itemsize + state.order.itemsize
    per_agent = state.agents.itemsize + 4 * state.observations.shape[2]
    per_road = roads.itemsize + state.lanes.itemsize * state.lanes.shape[1]
    return float(2 * (vehicles * per_vehicle + live * per_agent + per_road))


def measure_cpu() -> float:
    """Vehicle-steps per second of all processors, each with a thread."""
    number = count_processors()
    simulator = Simulator("paper", 1024 * number, num_threads=number, overrides=FAST, seed=0)
    simulator.reset()
    times = []
    for _ in range(ROUNDS):
        start = time.perf_counter()
        simulator.step()
        times.append(time.perf_counter() - start)
    return float(simulator.roads["num_vehicles"].sum()) / statistics.median(times)


def capture(call: Callable[[], object]) -> Callable[[], object]:
    """The call as a CUDA graph."""
    stream = cuda.Stream()
    stream.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(stream):
        call()
    torch.cuda.current_stream().wait_stream(stream)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        call()
    return graph.replay


def measure(num_envs: int, bandwidth: float) -> dict[str, float]:
    """The figures of so many roads on the GPU."""
    start = time.perf_counter()
    env = LaneChangeEnv("paper", num_envs, device="cuda", overrides=FAST, seed=0)
    data = env.reset()
    simulator = env.simulator
    shape = simulator.num_envs, simulator.num_slots, simulator.num_actions
    actions = np.random.default_rng(0).uniform(-0.02, 0.02, shape)
    data["changers", "action"] = torch.as_tensor(actions, dtype=torch.float32, device="cuda")
    env.step(data.copy())
    made = time.perf_counter() - start
    number = max(4, min(100, 2**20 // num_envs))
    replay = capture(lambda: advance(env))
    # The actions drive vehicles off the road, so their number falls.
    before = float(simulator.roads["num_vehicles"].sum())
    step = time_on_gpu(replay, number)
    vehicles = 0.5 * (before + float(simulator.roads["num_vehicles"].sum()))
    needed = num_envs * count_bytes(simulator) / bandwidth
    times = {
        "step": step,
        "called": time_on_gpu(simulator.advance, number),
        "env": time_on_gpu(lambda: env.step(data.copy()), number),
        "env_graph": time_on_gpu(capture(lambda: env.step(data.copy())), number),
    }
    return {
        "num_envs": num_envs,
        "vehicles_per_road": vehicles / num_envs,
        "seconds_until_stepped": made,
        **{f"{name}_ms": 1e3 * value for name, value in times.items()},
        "vehicle_steps_per_second": vehicles / times["step"],
        "limit_ms": 1e3 * needed,
        "share_of_limit": needed / times["step"],
    }


def advance(env: LaneChangeEnv) -> None:
    """The kernel alone, on torch's present stream."""
    stream = torch.cuda.current_stream().cuda_stream
    with env.simulator.gpu_roads.on_stream(stream):
        env.simulator.advance()


def run_tests() -> bool:
    """Whether the roads on the GPU are those on the CPU; here, so that kernels compile once."""
    import pytest

    files = [str(ROOT / file) for file in TESTS]
    options = ["-q", "-W", "ignore", "-p", "no:cacheprovider", "-c", str(ROOT / "pyproject.toml")]
    return pytest.main([*options, *files]) == 0


def main(arguments: list[str] | None = None) -> int:
    """Run the tests, print the tables and the targets, write the JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--json", type=Path, help="write the figures to this file as well")
    parser.add_argument("--no-tests", action="store_true", help="leave the tests out")
    options = parser.parse_args(arguments)
    bandwidth = measure_bandwidth()
    card = torch.cuda.get_device_name(0)
    print(f"{card}; a copy moves {bandwidth / 1e12:.2f} TB/s", flush=True)
    rows = [measure(num_envs, bandwidth) for num_envs in ENVS]
    print_rows(rows)
    cpu = measure_cpu()
    print(f"the CPU, {count_processors()} threads: {cpu / 1e9:.3f} 10^9 vehicle-steps/s")
    print_targets(rows)
    figures: dict[str, object] = {"card": card, "copy_bytes_per_second": bandwidth, "rows": rows}
    figures |= {"cpu_threads": count_processors(), "cpu_vehicle_steps_per_second": cpu}
    if options.json is not None:
        write_json(options.json, figures)
    if options.no_tests:
        return 0
    are_equal = run_tests()
    if options.json is not None:
        write_json(options.json, figures | {"are_tests_passed": are_equal})
    return 0 if are_equal else 1


def print_targets(rows: list[dict[str, float]]) -> None:
    """The figures that have a target, with it."""
    best = max(rows, key=lambda row: row["vehicle_steps_per_second"])
    few = next(row for row in rows if row["num_envs"] == 8192)
    print_target("10^9 vehicle-steps/s, best batch", best["vehicle_steps_per_second"] / 1e9, 5.0)
    print_target("10^9 vehicle-steps/s, 8,192 roads", few["vehicle_steps_per_second"] / 1e9, 1.0)
    for name, row in (("best batch", best), ("8,192 roads", few)):
        for kind in ("env", "env_graph"):
            ratio = row[f"{kind}_ms"] / row["step_ms"]
            label = "LaneChangeEnv.step" + " as a graph" * (kind == "env_graph")
            print_target(f"{label} over the kernel, {name}", ratio, 1.5, is_least=False)


def print_rows(rows: list[dict[str, float]]) -> None:
    """The table."""
    heads = {
        "num_envs": "roads",
        "vehicles_per_road": "vehicles",
        "step_ms": "step [ms]",
        "called_ms": "called",
        "env_ms": "env.step",
        "env_graph_ms": "as graph",
        "limit_ms": "limit",
    }
    print("".join(f"{head:>11}" for head in heads.values()), "  10^9 vehicle-steps/s  of limit")
    for row in rows:
        shown = "".join(f"{row[name]:11,.4g}" for name in heads)
        rate = row["vehicle_steps_per_second"] / 1e9
        print(f"{shown}{rate:24.2f}{row['share_of_limit']:10.2f}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
