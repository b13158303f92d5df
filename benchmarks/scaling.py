"""What each part of a training costs, with workers and without, and what 1,000 cores would do.

python benchmarks/scaling.py [--recipe NAME] [--rounds N] [--workers N] [--ray] [--replay N]
    [--json FILE]

The collectors take turns (A B C A B C ...); a figure is the median of the rounds.
--ray starts a Ray cluster of two nodes on loopback. --replay N fills a replay buffer of N
transitions in memory and one in files. The plan multiplies the measured figures; nothing in it is
measured on 1,000 cores.
"""

import argparse
import os
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDictBase

from marl_lanes import LaneChangeEnv
from marl_lanes.files import write_json
from marl_lanes.recipes import FOLDER
from marl_lanes.training.algorithms.naf import NAF, TrainingConfig
from marl_lanes.training.checkpoint import make_network
from marl_lanes.training.collectors import LocalCollector, MakeCollector, TrafficCollector
from marl_lanes.training.command_line import compose_fields
from marl_lanes.training.config import read_config
from marl_lanes.training.learner import Learner
from marl_lanes.training.replay import Replay
from marl_lanes.training.resume import read_state
from marl_lanes.training.transitions import live_transitions
from marl_lanes.training.workers import ProcessCollector, RayTrafficCollector, Workers

CORES = 1000
"""Of the plan."""
WARM_UP_BATCHES = 40
"""Until the roads carry as many agents as they will."""
NUM_UPDATES = 200

Figures = dict[str, float]


def read_recipe(recipe: str) -> TrainingConfig:
    """The training program's configuration."""
    fields = compose_fields(TrainingConfig, FOLDER, [f"recipe={recipe}"])
    return read_config(TrainingConfig, fields)


def make_learner(
    config: TrainingConfig, folder: Path, num_workers: int, make_collector: MakeCollector
) -> Learner:
    """As the training program makes it."""
    env = LaneChangeEnv(
        config.scenario,
        config.collector.num_envs // num_workers,
        overrides=config.training_overrides,
        num_threads=1,
        seed=0,
    )
    network = make_network(env.scenario, config.network.mu, config.network.hidden_sizes)
    learner = Learner(config, env, NAF(config, env, network), make_collector=make_collector)
    learner.begin(folder)
    return learner


def seconds(action: Callable[[], Any]) -> float:
    """How long it takes."""
    start = time.perf_counter()
    action()
    return time.perf_counter() - start


def measure_memory(learner: Learner, batch: TensorDictBase) -> Figures:
    """Sizes [bytes]."""
    policy = learner.collector.policy
    tensors = [*policy.parameters(), *policy.buffers()]
    return {
        **learner.memory,
        "bytes_sent_per_transition": batch.bytes() / len(live_transitions(batch)),
        "bytes_of_policy": float(sum(tensor.nbytes for tensor in tensors)),
    }


def measure_learner(learner: Learner, config: TrainingConfig, rounds: int) -> Figures:
    """Seconds of an update and of storing a transition; what one learner can take a second."""
    storing, updating = [], []
    for _ in range(rounds):
        rows = live_transitions(learner.collector.next())
        learner.experience.extend(rows)
        batch = learner.collector.next()
        size = len(live_transitions(batch))

        def store(batch: TensorDictBase = batch) -> None:
            learner.experience.extend(live_transitions(batch))

        def update() -> None:
            learner.update(NUM_UPDATES)

        storing.append(seconds(store) / size)
        updating.append(seconds(update) / NUM_UPDATES)
    store_seconds, update_seconds = statistics.median(storing), statistics.median(updating)
    a_transition = store_seconds + update_seconds / config.optimizer.transitions_per_update
    return {
        "store_microseconds_per_transition": 1e6 * store_seconds,
        "update_milliseconds": 1e3 * update_seconds,
        "learner_transitions_per_second": 1.0 / a_transition,
    }


@contextmanager
def two_nodes() -> Iterator[str]:
    """The address of a Ray cluster of two nodes on loopback."""
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    from ray.cluster_utils import Cluster

    node: dict[str, Any] = {
        "num_cpus": 1,
        "object_store_memory": 200 * 2**20,
    }
    cluster = Cluster(initialize_head=True, head_node_args={**node, "include_dashboard": False})
    try:
        cluster.add_node(**node)
        yield str(cluster.address)
    finally:
        cluster.shutdown()  # type: ignore[no-untyped-call]


def measure_collectors(
    collectors: Mapping[str, TrafficCollector], rounds: int
) -> dict[str, Figures]:
    """Time steps of roads a second of each, in turn, and the time that sending the policy takes.

    How many agents act differs from road to road: transitions a second are those of the mean over
    all collectors.
    """
    steps: dict[str, list[float]] = {name: [] for name in collectors}
    sending: dict[str, list[float]] = {name: [] for name in collectors}
    num_steps = num_transitions = 0
    for _ in range(rounds):
        for name, collector in collectors.items():
            start = time.perf_counter()
            batches = [collector.next() for _ in range(10)]
            elapsed = time.perf_counter() - start
            number = sum(batch.numel() for batch in batches)
            steps[name].append(number / elapsed)
            num_steps += number
            num_transitions += sum(int(batch["changers", "acting"].sum()) for batch in batches)
            if isinstance(collector, Workers):
                sending[name] += [seconds(collector.send_policy) for _ in range(5)]
    single = statistics.median(steps["single"])
    result = {}
    for name in collectors:
        rate = statistics.median(steps[name])
        result[name] = {
            "road_steps_per_second": rate,
            "ratio_to_single": rate / single,
            "transitions_per_second": rate * num_transitions / num_steps,
        }
        if sending[name]:
            result[name]["send_policy_milliseconds"] = 1e3 * statistics.median(sending[name])
    return result


def measure_replay(
    learner: Learner, config: TrainingConfig, capacity: int, folder: Path
) -> dict[str, Figures]:
    """A replay buffer of ``capacity`` in memory and in files: store, draw, write the state."""
    rows = live_transitions(learner.collector.next())
    size = learner.memory["bytes_per_stored_transition"]
    result = {}
    kept = learner.experience

    def draw() -> None:
        replay.sample(config.replay.batch_size)

    for storage in ("memory", "memmap"):
        settings = config.replay.model_copy(update={"storage": storage, "capacity": capacity})
        replay = Replay(
            settings,
            folder / storage,
            size,
            transitions_per_update=config.optimizer.transitions_per_update,
        )
        learner.experience = replay

        def fill() -> None:
            for _ in range(-(-capacity // len(rows))):
                learner.experience.extend(rows.clone())

        filling = seconds(fill)
        drawing = [seconds(draw) for _ in range(NUM_UPDATES)]
        result[storage] = {
            "capacity": float(capacity),
            "store_microseconds_per_transition": 1e6 * filling / capacity,
            "draw_milliseconds": 1e3 * statistics.median(drawing),
            "save_state_seconds": seconds(learner.save),
            "read_state_seconds": seconds(lambda: read_state(learner.run.state)),
            "state_bytes": float(learner.run.state.stat().st_size),
        }
    learner.experience = kept
    return result


def plan(config: TrainingConfig, found: dict[str, Any], kind: str) -> Figures:
    """What CORES would do, by multiplying what was measured; ``kind`` sends the policy."""
    memory, learner, collectors = found["memory"], found["learner"], found["collectors"]
    workers = collectors[kind]
    core = collectors["multi, 1 worker"]["transitions_per_second"]
    capacity = learner["learner_transitions_per_second"]
    collected = CORES * core
    store = learner["store_microseconds_per_transition"] * 1e-6
    update = learner["update_milliseconds"] * 1e-3
    # In turns, as this program does it: n cores collect, then one learns.
    per_run = max(1.0, round(capacity / core))
    in_turn = 1.0 / (1.0 / (per_run * core) + 1.0 / capacity)
    sending = workers["send_policy_milliseconds"] * 1e-3 / workers["num_workers"]
    num_steps = config.collector.num_envs * config.collector.steps_per_batch
    return {
        "cores": float(CORES),
        "transitions_per_second_of_a_core": core,
        "transitions_per_second_of_all": collected,
        "megabytes_per_second_sent": collected * memory["bytes_sent_per_transition"] / 1e6,
        "cores_that_saturate_a_learner": capacity / core,
        "transitions_per_second_of_such_a_run": in_turn,
        "such_runs_on_all_cores": CORES / (per_run + 1.0),
        "cores_that_storing_alone_saturates": 1.0 / (core * store),
        "transitions_per_update_that_cost_an_update": update / store,
        "send_policy_seconds_to_all": sending * CORES,
        "batch_seconds_of_a_core": num_steps
        / collectors["multi, 1 worker"]["road_steps_per_second"],
        "gigabytes_of_roads": CORES
        * config.collector.num_envs
        * memory["bytes_per_environment"]
        / 1e9,
        "gigabytes_of_1e7_transitions": 1e7 * memory["bytes_per_stored_transition"] / 1e9,
    }


def show(title: str, figures: Figures) -> None:
    """A table of two columns."""
    print(title)
    for name, value in figures.items():
        print(f"  {name:44} {value:16,.4g}" if value < 1e4 else f"  {name:44} {value:16,.0f}")


def main() -> None:
    """Measure, print, write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--recipe", default="fast", help="of `marl-lanes train` (default: fast)")
    parser.add_argument("--rounds", type=int, default=5, help="turns of each (default: 5)")
    parser.add_argument("--workers", type=int, default=2, help="processes (default: 2)")
    parser.add_argument("--ray", action="store_true", help="a Ray cluster of two nodes as well")
    parser.add_argument("--replay", type=int, default=1_000_000, help="(default: 1,000,000)")
    parser.add_argument("--json", type=Path, help="write the figures to this file as well")
    options = parser.parse_args()
    torch.set_num_threads(1)
    config = read_recipe(options.recipe)
    found: dict[str, Any] = {}
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(dir=".")))
        number = options.workers
        makers: dict[str, tuple[int, MakeCollector]] = {
            "single": (1, LocalCollector),
            "multi, 1 worker": (1, partial(ProcessCollector, num_workers=1)),
            f"multi, {number} workers": (number, partial(ProcessCollector, num_workers=number)),
        }
        if options.ray:
            address = stack.enter_context(two_nodes())
            ray = partial(RayTrafficCollector, num_workers=2, address=address)
            makers["ray, 2 nodes"] = (2, ray)
        learners = {}
        for name, (workers, maker) in makers.items():
            learner = make_learner(config, folder / name, workers, maker)
            stack.callback(learner.close)
            learners[name] = learner
            for _ in range(WARM_UP_BATCHES):
                batch = learner.collector.next()
        found["memory"] = measure_memory(learner, batch)
        show("memory", found["memory"])
        found["learner"] = measure_learner(learners["single"], config, options.rounds)
        show("learner", found["learner"])
        collectors = {name: learner.collector for name, learner in learners.items()}
        found["collectors"] = measure_collectors(collectors, options.rounds)
        for name, figures in found["collectors"].items():
            figures["num_workers"] = float(makers[name][0])
            show(f"collector: {name}", figures)
        found["replay"] = measure_replay(
            learners["single"], config, options.replay, folder / "replay"
        )
        for name, figures in found["replay"].items():
            show(f"replay.storage={name}", figures)
        found["plan"] = plan(config, found, list(makers)[-1])
        show(f"plan for {CORES} cores; the policy is sent as in {list(makers)[-1]}", found["plan"])
    if options.json is not None:
        write_json(options.json, found)


if __name__ == "__main__":
    main()
