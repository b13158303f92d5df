"""A training that never leaves the GPU: its time, that to a good cost ratio, that of an update.

python benchmarks/gpu_training.py [--json FILE] [FIELD=VALUE ...]

The fields are those of agents/naf/train.py, and its recipe is fast but for DEFAULTS: the numbers of
many roads, and of a network that is untrained and drives badly before. The time is that of the
training without evaluating, saving, and the first updates of each stage, in which torch compiles
and captures: those seconds have a line of their own.
The models that it saves are evaluated afterwards, on the CPU, until one is good, and the last one.
"""

import argparse
import copy
import math
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import torch
from tensordict import TensorDictBase
from torch import Tensor

from marl_lanes import LaneChangeEnv, Scenario
from marl_lanes.evaluation.metrics import evaluate
from marl_lanes.evaluation.rollout import run_maneuvers
from marl_lanes.experiment import start
from marl_lanes.files import write_json
from marl_lanes.naf.checkpoint import PolicyNetwork, greedy_policy
from marl_lanes.recipes import FOLDER
from marl_lanes.training.algorithms.naf import NAF, TrainingConfig
from marl_lanes.training.checkpoint import make_network
from marl_lanes.training.command_line import compose_fields, refusing
from marl_lanes.training.config import read_config
from marl_lanes.training.graphs import NUM_WARMUPS
from marl_lanes.training.learner import Learner
from marl_lanes.training.timing import split_time
from marl_lanes.training.transitions import CPU

DEFAULTS = (
    "recipe=fast",
    "device=cuda",
    # Untrained, the structure cascade drives well: what is measured would be nothing.
    "network.mu=paper",
    "collector.num_envs=8192",
    "collector.steps_per_batch=8",
    "collector.total_transitions=6000000",
    "replay.batch_size=1024",
    "replay.capacity=65536",
    "replay.rare_share=0.0",
    "loss.gamma=0.99",
    "loss.num_steps=1",
    "loss.tau=0.02",
    "optimizer.mu_learning_rate=0.001",
    "optimizer.final_rate=1.0",
    "optimizer.max_gradient_norm=null",
    "optimizer.transitions_per_update=512",
    "optimizer.pretraining_transitions=300000",
    "exploration.initial_sigma=0.1",
    "exploration.final_sigma=0.02",
    "exploration.probability=1.0",
    "evaluation.save_interval=300000",
)
FIXED = ("evaluation.criterion=null", "evaluation.record=false", "demonstrations.num_transitions=0")
GOOD_RATIO, GOOD_RATE = 1.10, 0.99
"""Cost ratio, and success rate, of a good model."""
SECONDS_TO_GOOD = f"seconds to a cost ratio of {GOOD_RATIO} at a success rate of {GOOD_RATE}"
NUM_UPDATES = 1024
Row = dict[str, float | str]


class Preparing:
    """The time of the first updates of each kind, in which torch compiles and captures.

    Args:
        algorithm: its updates are timed until they are replayed.

    Attributes:
        seconds: until now.
    """

    def __init__(self, algorithm: NAF) -> None:
        self.seconds = 0.0
        self._algorithm = algorithm
        self._take_step = algorithm.take_step
        self._calls = Counter[tuple[bool, bool]]()
        algorithm.take_step = self.take_step  # type: ignore[method-assign]

    def take_step(self, batch: TensorDictBase, number: int) -> Mapping[str, Tensor]:
        """An update."""
        network, loss = self._algorithm.network, self._algorithm.config.loss
        kind = network.mu_frozen, number % loss.target_interval == 0
        self._calls[kind] += 1
        if self._calls[kind] > NUM_WARMUPS + 1:
            return self._take_step(batch, number)
        wait()
        begin = time.perf_counter()
        found = self._take_step(batch, number)
        wait()
        self.seconds += time.perf_counter() - begin
        return found


def train(config: TrainingConfig) -> tuple[Learner, Scenario, list[tuple[PolicyNetwork, float]]]:
    """Train; copies of the network, untrained first, and the seconds of training before each."""
    saved: list[tuple[PolicyNetwork, float]] = []

    def keep(network: PolicyNetwork, seconds: float) -> None:
        saved.append((copy.deepcopy(network).to(CPU), seconds))

    def make(env: LaneChangeEnv, scenario: Scenario, *devices: torch.device) -> NAF:
        network = make_network(scenario, config.network.mu, config.network.hidden_sizes)
        keep(network, 0.0)
        return NAF(config, env, network, device=devices[0], acting_device=devices[1])

    learner, scenario = start(config, make, "benchmarks/gpu_training.py")
    preparing = Preparing(cast("NAF", learner.algorithm))

    def note(network: PolicyNetwork, _: Path | None) -> Mapping[str, Any]:
        keep(network, learner.counters["seconds_training"] - preparing.seconds)
        return dict.fromkeys(config.evaluation.metrics)

    try:
        learner.train(note)
        learner.counters["seconds_preparing"] = preparing.seconds
        learner.counters["seconds_update"] = time_update(learner)
    finally:
        learner.close()
    return learner, scenario, saved


def time_update(learner: Learner) -> float:
    """Time of an update, with the drawing of its batch [s]."""
    trained = learner.counters["updates"]
    learner.update(64)
    wait()
    begin = time.perf_counter()
    learner.update(NUM_UPDATES)
    wait()
    learner.counters["updates"] = trained
    return (time.perf_counter() - begin) / NUM_UPDATES


def wait() -> None:
    """For the GPU, if there is one."""
    if torch.cuda.is_available():
        torch.cuda.synchronize()


def measure_model(
    network: PolicyNetwork, scenario: Scenario, config: TrainingConfig
) -> tuple[float, float]:
    """Cost ratio and success rate."""
    settings = config.evaluation
    driven = run_maneuvers(
        scenario, greedy_policy(network), settings.num_maneuvers, seed=settings.saved_models_seed
    )
    found = evaluate(driven, scenario)
    ratio = found["cost_ratio"]
    # Where none succeeds there is none.
    return math.nan if ratio is None else ratio, found["success_rate"]


def measure(options: Sequence[str] = (), *, is_evaluated: bool = True) -> Row:
    """Train, evaluate if that is wanted; the results by what they are."""
    given = {option.partition("=")[0] for option in options}
    defaults = [option for option in DEFAULTS if option.partition("=")[0] not in given]
    with tempfile.TemporaryDirectory() as folder:
        fields = [*defaults, *options, *FIXED, f"output={folder}/run"]
        config = read_config(TrainingConfig, compose_fields(TrainingConfig, FOLDER, fields))
        learner, scenario, saved = train(config)
    counters = learner.counters
    prepared = counters["seconds_preparing"]
    seconds = dict(counters)
    for name in ("seconds_training", "seconds_learning"):
        seconds[name] -= prepared
    split = split_time(seconds, learner.transitions)
    row: Row = {
        "training: transitions": learner.transitions,
        "training: updates": counters["updates"],
        "training: seconds": seconds["seconds_training"],
        "training: seconds of compiling and capturing updates": prepared,
        **{f"training: us a transition: {key}": us for key, (us, _) in split.items()},
        f"an update of {config.replay.batch_size}: us": 1e6 * counters["seconds_update"],
    }
    return row | evaluate_models(saved, scenario, config) if is_evaluated else row


def evaluate_models(
    saved: Sequence[tuple[PolicyNetwork, float]], scenario: Scenario, config: TrainingConfig
) -> Row:
    """The untrained model, all until one is good, and the last one."""
    good: float | None = None
    results = []
    for network, seconds in saved:
        if good is None or network is saved[-1][0]:
            ratio, rate = measure_model(network, scenario, config)
            results.append((ratio, rate))
            if good is None and ratio <= GOOD_RATIO and rate >= GOOD_RATE:
                good = seconds
    return {
        SECONDS_TO_GOOD: "not reached" if good is None else good,
        "untrained: cost ratio": shown(results[0][0]),
        "untrained: success rate": results[0][1],
        "final model: cost ratio": shown(results[-1][0]),
        "final model: success rate": results[-1][1],
    }


def shown(ratio: float) -> float | str:
    """A cost ratio, where there is one: JSON knows no other number."""
    return "none succeeds" if math.isnan(ratio) else ratio


def print_row(row: Row) -> None:
    """A line for each result."""
    for name, value in row.items():
        print(f"{name:60} {value if isinstance(value, str) else f'{value:,.4g}'}", file=sys.stdout)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--json", type=Path, help="file to write the results to")
    parser.add_argument("overrides", nargs="*", metavar="FIELD=VALUE")
    options = parser.parse_intermixed_args(arguments)
    with refusing():
        row = measure(options.overrides)
    print_row(row)
    if options.json is not None:
        write_json(options.json, row)


if __name__ == "__main__":
    main()
