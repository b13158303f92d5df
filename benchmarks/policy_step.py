"""What a policy step costs with more and more empty slots, and where a training's time goes.

python benchmarks/policy_step.py [--rounds N] [--transitions N] [--json FILE]

First the same number of acting agents among more and more slots: the policy as a training uses it,
which evaluates acting agents alone, and the network on every slot, in turn. Then short trainings by
the recipes of agents/naf: microseconds for each collected live transition.
"""

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import torch
from tensordict import TensorDict
from torch import Tensor, nn

from marl_lanes import LaneChangeEnv, load_scenario
from marl_lanes.files import write_json
from marl_lanes.naf.checkpoint import PolicyNetwork
from marl_lanes.recipes import FOLDER
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.training.algorithms.naf import NAF, TrainingConfig
from marl_lanes.training.checkpoint import make_network
from marl_lanes.training.command_line import compose_fields
from marl_lanes.training.config import EVALUATED, read_config
from marl_lanes.training.learner import Learner
from marl_lanes.training.timing import OTHER, format_split
from marl_lanes.training.transitions import LivePolicy

NUM_ENVS, NUM_ACTING, STEPS_PER_TURN = 256, 512, 20
SLOTS = (4, 16, 64)
RECIPES = ("fast", "paper", "interactive")
OTHER_TARGET = 0.1
"""Share of the time for what is not simulate, act, store or learn: at most this."""


class Counted(nn.Module):
    """A policy that counts the rows it is given."""

    def __init__(self, policy: nn.Module) -> None:
        super().__init__()
        self.policy = policy
        self.rows = 0

    def forward(self, observation: Tensor) -> Tensor:
        """The policy's actions."""
        self.rows += observation.shape[:-1].numel()
        actions: Tensor = self.policy(observation)
        return actions


def measure_slots(rounds: int) -> list[dict[str, float]]:
    """For each number of slots: CPU microseconds a step, and rows through the network."""
    torch.manual_seed(0)
    network = make_network(load_scenario("paper"), "paper")
    contestants: dict[tuple[int, str], tuple[Counted, Callable[[], object]]] = {}
    for slots in SLOTS:
        acting = torch.zeros(NUM_ENVS * slots, dtype=torch.bool)
        acting[torch.randperm(NUM_ENVS * slots)[:NUM_ACTING]] = True
        group = {
            "observation": torch.randn(NUM_ENVS, slots, len(network.features)),
            "acting": acting.reshape(NUM_ENVS, slots),
        }
        data = TensorDict({CHANGER.group: TensorDict(group, [NUM_ENVS, slots])}, [NUM_ENVS])
        for name in ("live", "all"):
            counted = Counted(network.policy().module)
            contestants[slots, name] = counted, _stepper(name, counted, data)
    times: dict[tuple[int, str], list[float]] = {key: [] for key in contestants}
    for _ in range(rounds + 1):
        for key, (_, step) in contestants.items():
            start = time.process_time()
            for _ in range(STEPS_PER_TURN):
                step()
            times[key].append((time.process_time() - start) / STEPS_PER_TURN * 1e6)
    steps = (rounds + 1) * STEPS_PER_TURN
    return [
        {"slots": slots}
        | {
            f"{name}_microseconds": statistics.median(times[slots, name][1:])
            for name in ("live", "all")
        }
        | {f"{name}_rows": contestants[slots, name][0].rows / steps for name in ("live", "all")}
        for slots in SLOTS
    ]


def _stepper(name: str, counted: Counted, data: TensorDict) -> Callable[[], object]:
    policy = LivePolicy(counted, 1)
    if name == "live":
        return lambda: policy(data)

    def on_all() -> object:
        with torch.no_grad():
            return counted(data[CHANGER.group, "observation"])

    return on_all


def measure_split(recipe: str, transitions: int) -> dict[str, tuple[float, float]]:
    """A short training's time by activity, without evaluating and saving."""
    options = [
        f"recipe={recipe}",
        f"collector.total_transitions={transitions}",
        f"evaluation.save_interval={10 * transitions}",
        "evaluation.record=false",
        f"replay.warmup_transitions={transitions // 20}",
        # In stage two from the start: mu learns, too.
        "optimizer.pretraining_transitions=0",
    ]
    config = read_config(TrainingConfig, compose_fields(TrainingConfig, FOLDER, options))
    scenario = load_scenario(config.scenario)
    env = LaneChangeEnv(
        scenario, config.collector.num_envs, seed=0, overrides=config.training_overrides
    )
    torch.manual_seed(0)
    network = make_network(scenario, config.network.mu)
    learner = Learner(config, env, NAF(config, env, network))
    with tempfile.TemporaryDirectory() as folder:
        learner.begin(Path(folder) / "run")
        learner.train(_no_evaluation)
        learner.close()
    return learner.split


def _no_evaluation(network: PolicyNetwork, recorded: Path | None) -> dict[str, None]:  # noqa: ARG001
    """Evaluate nothing."""
    return dict.fromkeys(EVALUATED)


def main() -> None:
    """Measure both, print the tables, write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=21, help="turns of each (default: 21)")
    parser.add_argument(
        "--transitions", type=int, default=150_000, help="of recipe fast (default: 150000)"
    )
    parser.add_argument("--json", type=Path, help="write the figures to this file as well")
    options = parser.parse_args()
    torch.set_num_threads(1)
    slots = measure_slots(options.rounds)
    print(f"{NUM_ACTING} acting agents on {NUM_ENVS} roads; CPU microseconds a policy step")
    print(f"{'slots':>6} {'live: rows':>11} {'time':>8} {'all: rows':>11} {'time':>8}")
    for row in slots:
        print(
            f"{row['slots']:6} {row['live_rows']:11,.0f} {row['live_microseconds']:8,.0f} "
            f"{row['all_rows']:11,.0f} {row['all_microseconds']:8,.0f}"
        )
    splits = {}
    for recipe in RECIPES:
        # An update for each transition takes longer.
        number = options.transitions // 50 if recipe == "paper" else options.transitions
        splits[recipe] = measure_split(recipe, number)
        print(f"\nrecipe {recipe}; target: {OTHER} <= {OTHER_TARGET:.0%}")
        print(format_split(splits[recipe]))
    if options.json is not None:
        result = {"slots": slots, "split": splits, "other_target": OTHER_TARGET}
        write_json(options.json, result)


if __name__ == "__main__":
    main()
