"""A GPU: roads, environments and a training there, beside the CPU's and the limit.

python benchmarks/gpu.py [--json FILE] [--no-training] [--no-tests]

It is what to run where there is a GPU: in about three minutes, with no network, and with the extras
``gpu`` and ``train`` installed. It prints the tables, then the targets, and at last runs the tests
that hold the roads on the GPU against those on the CPU.

The scenario is ``paper`` as recipe fast once trained on it. The limit is the memory: the bytes that
a step must read and write, each once, over the bandwidth of a copy measured here. A step of
LaneChangeEnv is timed as it is called, and replayed as a CUDA graph, which leaves out Python. The
training is that of gpu_training.py, which has options; once with a compiled loss, for which torch
needs a C compiler, and once without. Both learn the same, so the models of one are evaluated.
"""

import argparse
import math
import statistics
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gpu_training import SECONDS_TO_GOOD, Row, print_row
from gpu_training import measure as measure_training
from tensordict import TensorDictBase
from torch._dynamo.exc import TorchDynamoException
from turns import print_target

from marl_lanes import LaneChangeEnv, Simulator
from marl_lanes.files import write_json
from marl_lanes.starting import uncollected
from marl_lanes.traffic.machine.graphics import find_gpu
from marl_lanes.traffic.machine.team import TEAM_SIZES
from marl_lanes.traffic.machine.threads import count_processors
from marl_lanes.training.command_line import refusing

FAST: dict[str, Any] = {
    "num_agents": None,
    "horizon": None,
    "num_slots": 4,
    "warmup": [40.0, 80.0],
    "command": {"probability": 1.0},
}
"""The training's overrides of recipe fast."""
ENVS = (1024, 8192, 65_536, 262_144)
DEVICE = "cuda"
FEW_ENVS = 8192
TESTS = ("tests/traffic/test_gpu.py", "tests/envs/test_gpu_exchange.py")
ROOT = Path(__file__).parents[1]
ROUNDS = 5
# torch.cuda carries no complete types.
cuda: Any = torch.cuda
COPIED = 2**30
"""[bytes]"""
TRAININGS = {"a compiled training": ("optimizer.compile=true",), "a training": ()}
"""The trainings' fields by name."""
ON_CPU = (
    "device=cpu",
    "collector.total_transitions=200000",
    "optimizer.pretraining_transitions=60000",
    "evaluation.save_interval=200000",
)
"""The training's fields for a part of it on the CPU."""


def time_on_gpu(call: Callable[[], object], number: int) -> float:
    """Time of a call in a row of ``number`` [s]."""
    call()
    start, end = (cuda.Event(enable_timing=True) for _ in range(2))
    torch.cuda.synchronize()
    start.record()
    for _ in range(number):
        call()
    end.record()
    torch.cuda.synchronize()
    return float(1e-3 * start.elapsed_time(end) / number)


def check_gpu() -> None:
    """Whether torch and the kernels can use a GPU; a ValueError if not."""
    find_gpu(0)
    if not torch.cuda.is_available():
        raise ValueError(f"torch {torch.__version__} can use no GPU: install its build for CUDA")


def measure_bandwidth() -> float:
    """Bytes read and written per second by a copy within the GPU's memory."""
    source = torch.empty(COPIED, dtype=torch.uint8, device=DEVICE)
    target = torch.empty_like(source)
    times = [time_on_gpu(lambda: target.copy_(source), 10) for _ in range(ROUNDS)]
    return 2 * COPIED / statistics.median(times)


def count_bytes(simulator: Simulator) -> float:
    """What a step of a road must read and write: vehicles on it, live agents, the road itself."""
    state, roads = simulator.state, simulator.roads
    vehicles, live = float(roads["num_vehicles"].mean()), float(roads["num_live"].mean())
    per_vehicle = state.vehicles.itemsize + state.order.itemsize
    per_agent = state.agents.itemsize + 4 * state.observations.shape[2]
    per_road = roads.itemsize + state.lanes.itemsize * state.lanes.shape[1]
    return float(2 * (vehicles * per_vehicle + live * per_agent + per_road))


def measure_cpu() -> dict[str, float]:
    """The same on all processors, each with a thread: vehicle-steps per second."""
    number = count_processors()
    env = LaneChangeEnv("paper", 1024 * number, num_threads=number, overrides=FAST, seed=0)
    data = env.rand_action(env.reset())
    simulator = env.simulator
    times: dict[str, list[float]] = {"Simulator": [], "LaneChangeEnv": []}
    for _ in range(ROUNDS):
        for name, call in (
            ("Simulator", simulator.step),
            ("LaneChangeEnv", lambda: env.step(data)),
        ):
            start = time.perf_counter()
            call()
            times[name].append(time.perf_counter() - start)
    vehicles = float(simulator.roads["num_vehicles"].sum())
    return {name: vehicles / statistics.median(found) for name, found in times.items()}


def capture(call: Callable[[], object]) -> Callable[[], object]:
    """The call as a CUDA graph."""
    stream = cuda.Stream()
    stream.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(stream):
        call()
    torch.cuda.current_stream().wait_stream(stream)
    graph = torch.cuda.CUDAGraph()
    with uncollected(), torch.cuda.graph(graph):
        call()
    return graph.replay


def make_env(num_envs: int) -> tuple[LaneChangeEnv, TensorDictBase]:
    """So many roads on the GPU, and actions that keep most vehicles on them."""
    env = LaneChangeEnv("paper", num_envs, device=DEVICE, overrides=FAST, seed=0)
    data = env.reset()
    simulator = env.simulator
    shape = simulator.num_envs, simulator.num_slots, simulator.num_actions
    actions = np.random.default_rng(0).uniform(-0.02, 0.02, shape)
    data["changers", "action"] = torch.as_tensor(actions, dtype=torch.float32, device=DEVICE)
    env.step(data.copy())
    return env, data


def measure(num_envs: int, bandwidth: float) -> dict[str, float]:
    """The figures of so many roads on the GPU."""
    start = time.perf_counter()
    env, data = make_env(num_envs)
    made = time.perf_counter() - start
    simulator = env.simulator
    number = max(4, min(50, 2**20 // num_envs))
    calls: dict[str, Callable[[], object]] = {
        "step": capture(lambda: advance(env)),
        "env_graph": capture(lambda: env.step(data.copy())),
        "env": lambda: env.step(data.copy()),
    }
    # They take turns, because what is on the roads changes.
    times: dict[str, list[float]] = {name: [] for name in calls}
    vehicles = []
    for _ in range(ROUNDS):
        vehicles.append(float(simulator.roads["num_vehicles"].sum()))
        for name, call in calls.items():
            times[name].append(time_on_gpu(call, number))
    count = statistics.median(vehicles)
    needed = num_envs * count_bytes(simulator) / bandwidth
    found = {name: statistics.median(values) for name, values in times.items()}
    return {
        "num_envs": num_envs,
        "team_size": simulator.gpu_roads.team_size,
        "vehicles_per_road": count / num_envs,
        "seconds_until_stepped": made,
        **{f"{name}_ms": 1e3 * value for name, value in found.items()},
        "vehicle_steps_per_second": count / found["step"],
        "limit_ms": 1e3 * needed,
        "share_of_limit": needed / found["step"],
    }


def measure_teams(num_envs: int) -> dict[str, float]:
    """Milliseconds of a step of so many roads, by the threads for each."""
    env, _ = make_env(num_envs)
    found = {}
    for size in TEAM_SIZES:
        env.simulator.gpu_roads.form_teams(size)
        call = capture(lambda: advance(env))
        found[str(size)] = 1e3 * statistics.median(time_on_gpu(call, 8) for _ in range(ROUNDS))
    return found


def advance(env: LaneChangeEnv) -> None:
    """The kernel alone, on torch's present stream."""
    stream = torch.cuda.current_stream().cuda_stream
    with env.simulator.gpu_roads.on_stream(stream):
        env.simulator.advance()


def train() -> dict[str, Row]:
    """The figures of the trainings by name; the cause where torch cannot compile."""
    found: dict[str, Row] = {}
    is_evaluated = True
    for name, options in TRAININGS.items():
        try:
            found[name] = measure_training(options, is_evaluated=is_evaluated)
            is_evaluated = False
        except TorchDynamoException as error:
            found[name] = {"error": str(error).partition("\n")[0]}
        print_row({f"{name}: {key}": value for key, value in found[name].items()})
    return found


def run_tests() -> bool:
    """Whether the roads on the GPU are those on the CPU; here, so that kernels compile once."""
    import pytest

    files = [str(ROOT / file) for file in TESTS]
    options = ["-q", "-W", "ignore", "-p", "no:cacheprovider", "-c", str(ROOT / "pyproject.toml")]
    return pytest.main([*options, *files]) == 0


def main(arguments: list[str] | None = None) -> int:
    """Print the tables and the targets, run the tests, write the JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--json", type=Path, help="write the figures to this file as well")
    parser.add_argument("--no-training", action="store_true", help="leave the training out")
    parser.add_argument("--no-tests", action="store_true", help="leave the tests out")
    options = parser.parse_args(arguments)
    begin = time.perf_counter()
    with refusing():
        check_gpu()
    bandwidth = measure_bandwidth()
    card = torch.cuda.get_device_name(0)
    print(f"{card}; a copy moves {bandwidth / 1e12:.2f} TB/s", flush=True)
    rows = [measure(num_envs, bandwidth) for num_envs in ENVS]
    print_rows(rows)
    best = max(rows, key=lambda row: row["vehicle_steps_per_second"])
    sizes = sorted({FEW_ENVS, int(best["num_envs"])})
    teams = {str(number): measure_teams(number) for number in sizes}
    print_teams(teams)
    cpu = measure_cpu()
    for name, rate in cpu.items():
        print(f"{name} on {count_processors()} processors: {rate / 1e9:.3f} 10^9 vehicle-steps/s")
    figures: dict[str, object] = {"card": card, "copy_bytes_per_second": bandwidth, "rows": rows}
    figures |= {"team_ms": teams, "cpu_threads": count_processors(), "cpu": cpu}

    def keep(**more: object) -> None:
        figures.update(more, seconds=time.perf_counter() - begin)
        if options.json is not None:
            write_json(options.json, figures)

    keep()
    trained: dict[str, Row] = {}
    if not options.no_training:
        trained = train()
        on_cpu = measure_training([*ON_CPU], is_evaluated=False)
        print_row({f"the CPU: {name}": value for name, value in on_cpu.items()})
        keep(trainings=trained, training_on_cpu=on_cpu)
    print_targets(rows, best, trained)
    are_equal = True
    if not options.no_tests:
        are_equal = run_tests()
        keep(are_tests_passed=are_equal)
    print(f"{time.perf_counter() - begin:.0f} s")
    return 0 if are_equal else 1


def print_targets(
    rows: list[dict[str, float]], best: dict[str, float], trained: Mapping[str, Row]
) -> None:
    """The figures that have a target, with it."""
    few = next(row for row in rows if row["num_envs"] == FEW_ENVS)
    for name, row, target in (("best batch", best, 5.0), (f"{FEW_ENVS} roads", few, 1.0)):
        rate = row["vehicle_steps_per_second"] / 1e9
        print_target(f"10^9 vehicle-steps/s, {name}", rate, target)
        for kind in ("env", "env_graph"):
            ratio = row[f"{kind}_ms"] / row["step_ms"]
            label = "LaneChangeEnv.step" + " as a graph" * (kind == "env_graph")
            print_target(f"{label} over the kernel, {name}", ratio, 1.5, is_least=False)
    for name, found in trained.items():
        if "error" in found:
            continue
        update = next(value for key, value in found.items() if key.startswith("an update"))
        targets = {"seconds": (found["training: seconds"], 3.0), "us of an update": (update, 100.0)}
        if SECONDS_TO_GOOD in found:
            reached = found[SECONDS_TO_GOOD]
            targets[SECONDS_TO_GOOD] = math.inf if isinstance(reached, str) else reached, 1.5
        for label, (value, target) in targets.items():
            print_target(f"{name}: {label}", float(value), target, is_least=False)


def print_rows(rows: list[dict[str, float]]) -> None:
    """The table of roads."""
    heads = {
        "num_envs": "roads",
        "team_size": "team",
        "vehicles_per_road": "vehicles",
        "step_ms": "step [ms]",
        "env_ms": "env.step",
        "env_graph_ms": "as graph",
        "limit_ms": "limit",
    }
    print("".join(f"{head:>11}" for head in heads.values()), "  10^9 vehicle-steps/s  of limit")
    for row in rows:
        shown = "".join(f"{row[name]:11,.4g}" for name in heads)
        rate = row["vehicle_steps_per_second"] / 1e9
        print(f"{shown}{rate:24.2f}{row['share_of_limit']:10.2f}", flush=True)


def print_teams(teams: dict[str, dict[str, float]]) -> None:
    """The table of teams."""
    print("a step [ms] with so many threads for a road:")
    print("".join(f"{head:>11}" for head in ("roads", *map(str, TEAM_SIZES))))
    for number, times in teams.items():
        print(f"{int(number):11,}" + "".join(f"{value:11.4g}" for value in times.values()))


if __name__ == "__main__":
    sys.exit(main())
