"""Which part of NAF does what: trainings that differ from a base in one thing, and their table.

python agents/naf/ablate.py [--only NAME ...] [--seeds 0 1 2] [--output runs/ablations]
    [--processes N] [--quick] [--docs FILE]

Trains every variant with every seed, on a short budget; the same command goes on after an
interruption. ablations.csv has a row for each training, ablations.md one for each variant. --quick
is a budget of seconds that shows that everything works.
"""

import argparse
import csv
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from marl_lanes.evaluation.figures import read_table
from marl_lanes.evaluation.intervals import estimate_mean
from marl_lanes.evaluation.metrics import evaluate
from marl_lanes.evaluation.rollout import run_maneuvers
from marl_lanes.evaluation.tables import format_estimate
from marl_lanes.files import replacing, write_text
from marl_lanes.naf.checkpoint import greedy_policy
from marl_lanes.report.documents import check_document, format_table, insert_tables
from marl_lanes.scenario.yaml_files import read_yaml
from marl_lanes.studies import Run, carry_out, is_finished
from marl_lanes.terminal import lenient_streams
from marl_lanes.training.checkpoint import make_network
from marl_lanes.training.command_line import Parser, refusing
from marl_lanes.training.config import CONFIG_FILE
from marl_lanes.training.failures import TrainingError, ending
from marl_lanes.training.inputs import read_scenario
from marl_lanes.training.run_folder import EVALUATION_FILE, FINAL_MANEUVERS_FILE, TIMES_FILE

PROGRAM = "agents/naf/train.py"
SHORT = (
    "num_threads=1",
    "collector.total_transitions=300_000",
    "optimizer.pretraining_transitions=90_000",
    "exploration.annealing_transitions=300_000",
    "evaluation.save_interval=50_000",
    "evaluation.record=false",
)
ONE_ACTION = (
    "recipe=fast",
    *SHORT,
    "collector.num_envs=128",
    "optimizer.transitions_per_update=30",
    "demonstrations.num_transitions=0",
    "evaluation.criterion=null",
)
TWO_ACTIONS = ("recipe=interactive", *SHORT, "collector.num_envs=256")
QUICK = (
    "network.hidden_sizes=[8]",
    "training_overrides.warmup=[20.0,30.0]",
    "collector.num_envs=16",
    "collector.total_transitions=400",
    "optimizer.pretraining_transitions=200",
    "replay.warmup_transitions=64",
    "replay.batch_size=16",
    "evaluation.save_interval=200",
    "evaluation.num_maneuvers=2",
    "evaluation.final_num_maneuvers=4",
)


class Variant(NamedTuple):
    """A training that differs from its base in one thing."""

    label: str
    base: tuple[str, ...]
    changes: tuple[str, ...] = ()


VARIANTS = {
    "base": Variant(
        "**base**: recipe fast without demonstrations: mu cascade, gamma 0.998, targets over 8 "
        "steps, noise 0.05 to 0.005 on 0.1 of the actions, 0.1 rare",
        ONE_ACTION,
    ),
    "demonstrations": Variant(
        "20,000 demonstrations", ONE_ACTION, ("demonstrations.num_transitions=20_000",)
    ),
    "mu_paper": Variant("mu paper", ONE_ACTION, ("network.mu=paper",)),
    "mu_damped": Variant("mu damped", ONE_ACTION, ("network.mu=damped",)),
    "mu_mlp": Variant("mu mlp", ONE_ACTION, ("network.mu=mlp",)),
    "no_stage_one": Variant("no stage one", ONE_ACTION, ("optimizer.pretraining_transitions=0",)),
    "no_threshold": Variant(
        "mu without the soft threshold", ONE_ACTION, ("network.mu=cascade-smooth",)
    ),
    "plain_q": Variant(
        "Q without the action's own cost", ONE_ACTION, ("network.knows_action_cost=false",)
    ),
    "one_step": Variant("targets over one step", ONE_ACTION, ("loss.num_steps=1",)),
    "always_noisy": Variant("noise on every action", ONE_ACTION, ("exploration.probability=1.0",)),
    "fast_mu": Variant(
        "mu's step size 0.0005 instead of 0.00002",
        ONE_ACTION,
        ("optimizer.mu_learning_rate=0.0005",),
    ),
    "gamma_95": Variant("gamma 0.95", ONE_ACTION, ("loss.gamma=0.95",)),
    "gamma_99": Variant("gamma 0.99", ONE_ACTION, ("loss.gamma=0.99",)),
    "large_noise": Variant(
        "noise 0.1 to 0.04",
        ONE_ACTION,
        ("exploration.initial_sigma=0.1", "exploration.final_sigma=0.04"),
    ),
    "constant_noise": Variant(
        "noise 0.05 throughout", ONE_ACTION, ("exploration.final_sigma=0.05",)
    ),
    "small_noise": Variant("noise 0.01 to 0.005", ONE_ACTION, ("exploration.initial_sigma=0.01",)),
    "no_rare": Variant("no replay of rare phases", ONE_ACTION, ("replay.rare_share=0.0",)),
    "more_rare": Variant("0.3 of a batch are rare", ONE_ACTION, ("replay.rare_share=0.3",)),
    "full_m": Variant("**two actions**: M is full", TWO_ACTIONS),
    "diagonal_m": Variant("M is diagonal", TWO_ACTIONS, ("network.off_diagonal=false",)),
}
LIMITS = (1.15, 1.1)
"""Cost ratios; when a training reaches them is shown."""
LEAST_SUCCESS = 0.98
"""A saved model has reached a ratio only with this success rate."""
TABLE = "ablations"
MAX_ROADS = 10**6
"""More than an evaluation has."""

Row = dict[str, Any]


@lenient_streams()
def main(arguments: Sequence[str] | None = None) -> None:
    """Train, measure, write."""
    options = parse(arguments)
    torch.set_num_threads(1)
    with ending(options.output):
        failure = None
        with refusing():
            if options.docs is not None:
                check_document(options.docs, [TABLE])
            runs = {(name, seed): plan(name, seed, options) for name, seed in members(options)}
            try:
                is_whole = carry_out(
                    [*runs.values()], options.output, num_processes=options.processes
                )
            except TrainingError as error:
                # A training that diverges is a result; the others are reported.
                failure = error
        if failure is None and not is_whole:
            print("interrupted; the same command goes on")
            return
        report(options)
        if failure is not None:
            raise failure


def members(options: argparse.Namespace) -> list[tuple[str, int]]:
    """Variant and seed of every training."""
    return [(name, seed) for seed in options.seeds for name in options.only]


def plan(name: str, seed: int, options: argparse.Namespace) -> Run:
    """A training."""
    variant = VARIANTS[name]
    given = dict(word.split("=", 1) for word in (*variant.base, *(QUICK if options.quick else ())))
    given |= dict(word.split("=", 1) for word in variant.changes)
    words = [f"{field}={value}" for field, value in given.items()]
    return Run(f"{name}_{seed}", PROGRAM, (*words, f"seed={seed}"))


def report(options: argparse.Namespace) -> None:
    """Measure the finished trainings; write a row for each, and the table of the variants."""
    rows = [
        {"variant": name, "seed": seed, **measure(options.output / f"{name}_{seed}")}
        for name, seed in members(options)
        if is_finished(options.output / f"{name}_{seed}")
    ]
    if not rows:
        return
    with (
        replacing(options.output / "ablations.csv") as temporary,
        temporary.open("w", newline="", encoding="utf-8") as file,
    ):
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    found = {name: [row for row in rows if row["variant"] == name] for name in options.only}
    lines = [tabulate(name, trained, options) for name, trained in found.items() if trained]
    table = format_table(lines)
    write_text(options.output / "ablations.md", table)
    if options.docs is not None:
        insert_tables(options.docs, {TABLE: table})
    print(table)


def measure(folder: Path) -> Row:
    """What a training achieved, when, and what its policy was worth before."""
    final = json.loads((folder / EVALUATION_FILE).read_text(encoding="utf-8"))
    seconds = json.loads((folder / TIMES_FILE).read_text(encoding="utf-8"))
    start = measure_untrained(folder)
    saved = read_table(folder / "evaluations.csv")
    at, ratio, success = (
        np.insert(saved[key], 0, first)
        for key, first in (
            ("transitions", 0.0),
            ("cost_ratio", start["cost_ratio"] or np.nan),
            ("success_rate", start["success_rate"]),
        )
    )
    return {
        "success_rate": final["success_rate"],
        "cost_ratio": final["cost_ratio"],
        "last_cost_ratio": None if np.isnan(ratio[-1]) else float(ratio[-1]),
        "untrained_success_rate": start["success_rate"],
        "untrained_cost_ratio": start["cost_ratio"],
        **{
            f"transitions_to_{limit}": find_reached(
                at, (ratio <= limit) & (success >= LEAST_SUCCESS)
            )
            for limit in LIMITS
        },
        "lowest_success_rate": float(success[1:].min()),
        "training_seconds": seconds["seconds_training"],
    }


def find_reached(transitions: Any, is_good: Any) -> int | None:
    """Transitions of the first model from which on all are good."""
    bad = np.flatnonzero(~is_good)
    first = bad[-1] + 1 if bad.size else 0
    return int(transitions[first]) if first < len(transitions) else None


def measure_untrained(folder: Path) -> Row:
    """What the training's policy is worth before it, on the saved models' maneuvers."""
    config = read_yaml(folder / CONFIG_FILE)
    form, settings = config["network"], config["evaluation"]
    scenario = read_scenario(folder)
    torch.manual_seed(config["seed"])
    network = make_network(
        scenario,
        form["mu"],
        form["hidden_sizes"],
        knows_action_cost=form["knows_action_cost"],
        off_diagonal=form["off_diagonal"],
    )
    number, seed = settings["num_maneuvers"], settings["seed"] + 1
    maneuvers = run_maneuvers(scenario, greedy_policy(network), number, seed=seed)
    return evaluate(maneuvers, scenario)


def tabulate(name: str, rows: Sequence[Row], options: argparse.Namespace) -> Row:
    """The row of a variant: success with its interval, and the median and range of the seeds."""
    tables = [
        read_table(options.output / f"{name}_{row['seed']}" / FINAL_MANEUVERS_FILE) for row in rows
    ]
    success = np.concatenate([table["is_success"] for table in tables])
    # Seeds have roads of their own: a policy on the same traffic is another one.
    roads = np.concatenate(
        [table["road"] + index * MAX_ROADS for index, table in enumerate(tables)]
    )
    line: Row = {
        "variant": VARIANTS[name].label,
        "seeds": len(rows),
        "success [%]": format_estimate(vars(estimate_mean(success, roads, is_rate=True)), 100.0, 1),
        "lowest of a saved model [%]": spread(rows, "lowest_success_rate", 100.0, 0),
        "cost ratio": spread(rows, "cost_ratio", 1.0, 3),
        "last saved model": spread(rows, "last_cost_ratio", 1.0, 3),
        "untrained": spread(rows, "untrained_cost_ratio", 1.0, 3),
        "untrained success [%]": spread(rows, "untrained_success_rate", 100.0, 0),
    }
    for limit in LIMITS:
        line[f"transitions to {limit:g}"] = spread(rows, f"transitions_to_{limit}", 1e-3, 0, "k")
    line["training [s]"] = spread(rows, "training_seconds", 1.0, 0)
    return line


def spread(rows: Sequence[Row], key: str, factor: float, decimals: int, unit: str = "") -> str:
    """Median and range of the seeds that have a value."""
    values = [factor * row[key] for row in rows if row[key] is not None]
    if not values:
        return "never" if unit else "-"
    low, middle, high = min(values), float(np.median(values)), max(values)
    text = f"{middle:,.{decimals}f}{unit}"
    if low < high:
        text += f" [{low:,.{decimals}f}, {high:,.{decimals}f}]"
    return text if len(values) == len(rows) else f"{text} ({len(values)} of {len(rows)})"


def parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """The command line."""
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("runs/ablations"), help="folder")
    parser.add_argument(
        "--only",
        nargs="+",
        choices=list(VARIANTS),
        default=list(VARIANTS),
        metavar="NAME",
        help=f"variants: {', '.join(VARIANTS)} (default: all)",
    )
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2], metavar="N")
    parser.add_argument("--processes", type=int, default=1, help="trainings at a time (default: 1)")
    parser.add_argument("--quick", action="store_true", help="a budget of seconds")
    parser.add_argument("--docs", type=Path, metavar="FILE", help="put the table into it, too")
    return parser.parse_args(arguments)


if __name__ == "__main__":
    main()
