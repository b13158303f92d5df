"""Train every algorithm with equal budgets; compare it with the others and with no learning at all.

python agents/baselines/compare.py [--output runs/comparison] [--scenario paper] [--seeds 0 1 2]
    [--algorithms ippo mappo sac td3 ddpg naf naf-scratch] [--policies tuned-cascade]
    [--transitions 150000] [--seconds 60] [--processes 1] [--docs docs/baselines.md] [--quick]
    [--report]

Every algorithm trains once with so many transitions, then with as many as it makes in so many
seconds at the speed of the first training, and again if it took much more or less, as where other
programs ran beside one of the two. The same command goes on after an interruption;
--report writes the table again without measuring. naf is recipe fast, whose demonstrations count
among its transitions; naf-scratch has none.
"""

import argparse
import csv
import json
from collections.abc import Mapping, Sequence
from functools import partial
from math import ceil, inf
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import torch
import yaml
from tqdm import tqdm

from marl_lanes.cli.policies import make_policy
from marl_lanes.evaluation.comparison import (
    drive,
    format_comparison,
    is_good,
    measure,
    summarise,
    write_rows,
)
from marl_lanes.files import write_json
from marl_lanes.report.documents import check_document, insert_tables
from marl_lanes.scenario import Scenario, load_scenario
from marl_lanes.scenario.messages import shown
from marl_lanes.studies import Run, carry_out
from marl_lanes.terminal import lenient_streams
from marl_lanes.training.command_line import Parser, refusing
from marl_lanes.training.config import CONFIG_FILE
from marl_lanes.training.failures import ending
from marl_lanes.training.run_folder import CHECKPOINTS_FOLDER, FINAL_MODEL, TIMES_FILE

BASELINES, NAF = "agents/baselines/train.py", "agents/naf/train.py"
PROGRAMS: Mapping[str, tuple[str, ...]] = {
    **{name: (BASELINES, name) for name in ("ippo", "mappo", "sac", "td3", "ddpg")},
    "naf": (NAF,),
    "naf-scratch": (NAF, "demonstrations.num_transitions=0"),
}
"""By algorithm, the program that trains with it and its first arguments."""

NUM_GLANCES = 1
"""Maneuvers for each saved model in the training itself: what counts is measured after it."""

STAGE_ONE = 0.375
"""Share of the transitions in NAF's first stage, as in its recipe fast."""

DEMONSTRATIONS = 20_000
"""Transitions of an expert before NAF begins, as in its recipe fast."""

DEMONSTRATED = 0.2
"""[1] Largest share of them in all its transitions."""

MAX_ATTEMPTS, TOLERANCE = 3, 0.25
"""Trainings for the budget of seconds, until one has taken that, but for this share of it."""

Runs = Mapping[tuple[str, int], Run]
"""By algorithm and seed."""

RESULT_FILE = "comparison.json"
"""Of the comparison, and of each run."""

SEED = 1_000_000
"""Of the maneuvers of final models and policies; those of saved models have the next one."""

QUICK = {
    "saved_models": 1,
    "transitions": 400,
    "seconds": 0.1,
    "maneuvers": 4,
    "saved_maneuvers": 2,
}
QUICK_FIELDS = (
    "network.hidden_sizes=[8]",
    "collector.num_envs=16",
    "collector.steps_per_batch=8",
    "training_overrides.warmup=[20.0,30.0]",
)
QUICK_NAF = ("demonstrations.num_updates=20",)

TABLE = "comparison"
"""Its place in a document, for --docs."""


@lenient_streams()
def main(arguments: Sequence[str] | None = None) -> None:
    """Train, measure, compare."""
    options = parse(arguments)
    torch.set_num_threads(1)
    with refusing():
        if options.docs is not None:
            check_document(options.docs, [TABLE])
        rows = read_rows(options.output) if options.report else None
    if rows is None:
        rows = compare(options)
    if rows is None:
        print("interrupted; the same command goes on")
        return
    table = format_comparison(rows)
    print(table)
    if options.docs is not None:
        insert_tables(options.docs, {TABLE: f"{table}\n"})


def compare(options: argparse.Namespace) -> list[dict[str, Any]] | None:
    """Train and measure; write the rows and return them. None if interrupted."""
    with refusing():
        scenario = load_scenario(options.scenario)
        for name in options.policies:
            make_policy(name, scenario, SEED)
    with ending(options.output):
        with refusing():
            runs = train(options)
        if runs is None:
            return None
        tasks = [Task(name, "", None) for name in options.policies]
        # In the table by algorithm, in whatever order they were trained.
        keys = sorted(runs, key=lambda key: [*PROGRAMS].index(key[0]))
        tasks += [Task(*key, folder) for key in keys for folder in runs[key]]
        measured: dict[tuple[str, str], list[dict[str, Any]]] = {}
        for task, found in zip(tasks, measure_all(tasks, options), strict=True):
            measured.setdefault((task.name, task.budget), []).append(found)
    rows = [summarise(*key, found) for key, found in measured.items()]
    write_json(options.output / RESULT_FILE, {"scenario": scenario.name, "rows": rows})
    write_rows(options.output / "comparison.csv", rows)
    return rows


def read_rows(folder: Path) -> list[dict[str, Any]]:
    """The rows that a comparison has written.

    Raises:
        OSError, ValueError: there are none.
    """
    rows = read(folder / RESULT_FILE).get("rows")
    if not isinstance(rows, list):
        raise ValueError(f"--output {folder}: {RESULT_FILE} must have the rows of a comparison")
    return rows


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("runs/comparison"))
    parser.add_argument("--scenario", default="paper")
    parser.add_argument("--algorithms", nargs="*", choices=list(PROGRAMS), default=list(PROGRAMS))
    parser.add_argument("--policies", nargs="*", metavar="NAME", default=["tuned-cascade"])
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    parser.add_argument("--transitions", type=int, default=150_000)
    parser.add_argument("--seconds", type=float, default=60.0, help="0: that budget is left out")
    parser.add_argument(
        "--maneuvers", type=int, default=1000, help="for each final model or policy"
    )
    parser.add_argument("--saved-models", type=int, default=10, help="that each training saves")
    parser.add_argument("--saved-maneuvers", type=int, default=200, help="for each saved model")
    parser.add_argument(
        "--processes", type=int, default=1, help="trainings, then measurements, at a time"
    )
    parser.add_argument("--docs", type=Path, help="a Markdown file whose table is replaced")
    parser.add_argument(
        "--report", action="store_true", help="only write the table of a finished comparison again"
    )
    parser.add_argument("--quick", action="store_true", help="a tiny comparison, to see it work")
    options = parser.parse_args(arguments)
    if options.quick:
        vars(options).update(QUICK)
    if not options.algorithms and not options.policies:
        parser.error("--algorithms, --policies: must name something to compare")
    for name in ("transitions", "maneuvers", "saved_models", "saved_maneuvers"):
        if not getattr(options, name) > 0:
            field = name.replace("_", "-")
            parser.error(f"--{field} = {shown(getattr(options, name))}: must be above 0")
    if not 0.0 <= options.seconds < inf:
        parser.error(f"--seconds = {shown(options.seconds)}: must be 0 or more, and finite")
    return options


def train(options: argparse.Namespace) -> dict[tuple[str, str], list[Path]] | None:
    """Carry out all trainings.

    Returns:
        folders of the seeds' runs by algorithm and budget; None if interrupted.
    """
    members = [(algorithm, seed) for algorithm in options.algorithms for seed in options.seeds]
    budget = f"{options.transitions} transitions"
    first = {
        member: plan(options, *member, "transitions", options.transitions) for member in members
    }
    if not carry_out([*first.values()], options.output, num_processes=options.processes):
        return None
    second = train_for_seconds(options, first) if options.seconds else {}
    if second is None:
        return None
    found: dict[tuple[str, str], list[Path]] = {}
    for name, runs in ((budget, first), (f"{options.seconds:g} s", second)):
        for (algorithm, _), run in runs.items():
            found.setdefault((algorithm, name), []).append(options.output / run.name)
    return found


def train_for_seconds(options: argparse.Namespace, first: Runs) -> Runs | None:
    """Trainings that take the budget of seconds.

    Args:
        options: of the command line.
        first: trainings of known speed.

    Returns:
        the last training of each; None if interrupted.
    """
    last = dict(first)
    sizes = dict.fromkeys(first, options.transitions)
    waiting = [*first]
    for attempt in range(MAX_ATTEMPTS):
        name = "seconds" + attempt * "-again"
        for member in waiting:
            sizes[member] = count_affordable(options, member[0], last[member], sizes[member])
            last[member] = plan(options, *member, name, sizes[member])
        runs = [last[member] for member in waiting]
        if not carry_out(runs, options.output, num_processes=options.processes):
            return None
        waiting = [one for one in waiting if not is_in_time(options, last[one])]
        if not waiting:
            break
    return last


def plan(
    options: argparse.Namespace, algorithm: str, seed: int, budget: str, transitions: int
) -> Run:
    """A training with so many transitions; whatever falls, falls over all that it collects."""
    program, *first = PROGRAMS[algorithm]
    demonstrations = count_demonstrations(algorithm, transitions)
    transitions -= demonstrations
    fields = {
        "scenario": options.scenario,
        "seed": seed,
        "collector.total_transitions": transitions,
        "evaluation.save_interval": ceil(transitions / options.saved_models),
        # What is compared is measured here.
        "evaluation.num_maneuvers": NUM_GLANCES,
        "evaluation.final_num_maneuvers": NUM_GLANCES,
        "evaluation.record": "false",
        # Every training ends with its last model, not with the best that it saved.
        "evaluation.criterion": "null",
    }
    if demonstrations:
        fields["demonstrations.num_transitions"] = demonstrations
    if program == NAF:
        fields["optimizer.pretraining_transitions"] = round(STAGE_ONE * transitions)
        fields["exploration.annealing_transitions"] = transitions
    given = [f"{name}={value}" for name, value in fields.items()]
    quick = [*QUICK_FIELDS] if options.quick else []
    if options.quick and algorithm not in {"ippo", "mappo"}:
        quick.append("replay.warmup_transitions=32")
    if options.quick and program == NAF:
        quick.extend(QUICK_NAF)
    return Run(f"{algorithm}-{budget}-{seed}", program, (*first, *given, *quick))


def count_demonstrations(algorithm: str, transitions: int) -> int:
    """How many of its transitions an algorithm gets from an expert."""
    return min(DEMONSTRATIONS, int(DEMONSTRATED * transitions)) if algorithm == "naf" else 0


def count_affordable(options: argparse.Namespace, algorithm: str, run: Run, size: int) -> int:
    """Transitions in the budget of seconds at the speed of a training with so many.

    Neither its evaluations nor its demonstrations count as time.
    """
    demonstrated = count_demonstrations(algorithm, size)
    collected = options.seconds * (size - demonstrated) / measure_seconds(options, run)
    return demonstrated + max(100, int(round(collected, -2)))


def is_in_time(options: argparse.Namespace, run: Run) -> bool:
    """Whether a training took about the budget of seconds."""
    share = measure_seconds(options, run) / float(options.seconds)
    return 1.0 - TOLERANCE <= share <= 1.0 + TOLERANCE


def measure_seconds(options: argparse.Namespace, run: Run) -> float:
    """What a training took, without evaluations and demonstrations [s]."""
    return float(read(options.output / run.name / TIMES_FILE)["seconds_training"])


def read(path: Path) -> dict[str, Any]:
    """What ``write_json`` wrote."""
    content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return content


class Task(NamedTuple):
    """What is measured: the run in the folder, or, without one, the policy of this name."""

    name: str
    budget: str
    folder: Path | None


def measure_all(tasks: Sequence[Task], options: argparse.Namespace) -> list[dict[str, Any]]:
    """What each achieves, in so many processes."""
    measure_it = partial(measure_task, options=options)
    bar = partial(tqdm, total=len(tasks), unit="policy", desc="measuring")
    if options.processes == 1:
        return [*bar(map(measure_it, tasks))]
    # A fork of a process in which numba's threads have run does not survive.
    with get_context("spawn").Pool(options.processes) as pool:
        return [*bar(pool.imap(measure_it, tasks))]


def measure_task(task: Task, options: argparse.Namespace) -> dict[str, Any]:
    """What one achieves."""
    torch.set_num_threads(1)
    scenario = load_scenario(options.scenario)
    if task.folder is not None:
        return measure_run(task.folder, scenario, options)
    return measure(make_policy(task.name, scenario, SEED), scenario, options.maneuvers, SEED)


def measure_run(folder: Path, scenario: Scenario, options: argparse.Namespace) -> dict[str, Any]:
    """What a training's final model achieves, and when a saved one was good; kept in its folder."""
    path = folder / RESULT_FILE
    asked = {"maneuvers": options.maneuvers, "saved_maneuvers": options.saved_maneuvers}
    if path.exists():
        kept = read(path)
        if kept["asked"] == asked:
            return kept
    checkpoints = folder / CHECKPOINTS_FOLDER
    final = make_policy(str(checkpoints / FINAL_MODEL), scenario, SEED)
    found = measure(final, scenario, options.maneuvers, SEED) | {"asked": asked}
    config = yaml.safe_load((folder / CONFIG_FILE).read_text(encoding="utf-8"))
    demonstrated = config.get("demonstrations", {"num_transitions": 0})["num_transitions"]
    found["transitions_to_good"] = None
    for saved in sorted(checkpoints.glob("step_*.pt")):
        policy = make_policy(str(saved), scenario, SEED)
        if is_good(drive(policy, scenario, options.saved_maneuvers, SEED + 1)):
            found["transitions_to_good"] = int(saved.stem.removeprefix("step_")) + demonstrated
            break
    found["training_seconds"] = read(folder / TIMES_FILE)["seconds_training"]
    with (folder / "metrics.csv").open(newline="", encoding="utf-8") as file:
        found["transitions"] = int([*csv.DictReader(file)][-1]["transitions"]) + demonstrated
    write_json(path, found)
    return found


if __name__ == "__main__":
    main()
