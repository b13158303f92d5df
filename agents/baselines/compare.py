"""Train every algorithm with equal budgets; compare it with the others and with no learning at all.

python agents/baselines/compare.py [--output runs/comparison] [--scenario paper] [--seeds 0 1 2]
    [--algorithms ippo mappo sac td3 ddpg naf naf-scratch] [--policies tuned-cascade]
    [--transitions 150000] [--seconds 60] [--processes 1] [--docs docs/baselines.md] [--quick]
    [--report]

Every algorithm trains once with so many transitions, then with as many as it makes in so many
seconds at the speed of the first training. The same command goes on after an interruption;
--report writes the table again without measuring. naf is recipe fast, whose demonstrations count
among its transitions; naf-scratch has none.
"""

import argparse
import csv
import json
import timeit
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import partial
from math import ceil, inf
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
import yaml
from numpy.typing import NDArray
from tqdm import tqdm

from marl_lanes.cli.policies import make_policy
from marl_lanes.evaluation.driving import Policy
from marl_lanes.evaluation.intervals import Estimate, estimate_over_seeds
from marl_lanes.evaluation.metrics import AVERAGES, measure_each
from marl_lanes.evaluation.rollout import run_maneuvers
from marl_lanes.evaluation.tables import format_estimate
from marl_lanes.files import replacing, write_json, write_text
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

GOOD_RATIO, GOOD_SUCCESS = 1.15, 0.98
"""A model counts as good that has this cost ratio at most, and this success rate at least."""

RESULT_FILE = "comparison.json"
"""Of the comparison, and of each run."""

SEED = 1_000_000
"""Of the maneuvers of final models and policies; those of saved models have the next one."""

BATCHES = (1, 64)
"""Observations in a call of a policy, for the time of a decision."""

TIMED = 0.05
"""[s] In which decisions are timed together; the fastest of five times counts."""

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

COLUMNS = (
    ("success_rate", "success [%]", 100.0, 1),
    ("cost_ratio", "cost ratio", 1.0, 3),
    ("mean_peak_yaw_acceleration", "yaw acceleration [rad/s²]", 1.0, 3),
    ("mean_peak_yaw_rate", "yaw rate [rad/s]", 1.0, 4),
    ("mean_peak_lateral_acceleration", "lateral acceleration [m/s²]", 1.0, 2),
    ("mean_imposed_on_follower", "imposed on follower [m/s²]", 1.0, 2),
)
"""Key of docs/metrics.md, title, factor and decimals."""

FIGURES = (
    "transitions",
    "training_seconds",
    "transitions_to_good",
    "microseconds_of_1",
    "microseconds_of_64",
)
MARKS = ("<!-- table of agents/baselines/compare.py -->", "<!-- end of the table -->")


@lenient_streams()
def main(arguments: Sequence[str] | None = None) -> None:
    """Train, measure, compare."""
    options = parse(arguments)
    torch.set_num_threads(1)
    with refusing():
        check_docs(options.docs)
        rows = read_rows(options.output) if options.report else None
    if rows is None:
        rows = compare(options)
    if rows is None:
        print("interrupted; the same command goes on")
        return
    table = format_table(rows)
    print(table)
    if options.docs is not None:
        before, _, rest = options.docs.read_text(encoding="utf-8").partition(MARKS[0])
        after = rest.partition(MARKS[1])[2]
        write_text(options.docs, f"{before}{MARKS[0]}\n{table}\n{MARKS[1]}{after}")


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
    second = {}
    if options.seconds:
        second = {
            member: plan(options, *member, "seconds", count_affordable(options, member[0], run))
            for member, run in first.items()
        }
        if not carry_out([*second.values()], options.output, num_processes=options.processes):
            return None
    found: dict[tuple[str, str], list[Path]] = {}
    for name, runs in ((budget, first), (f"{options.seconds:g} s", second)):
        for (algorithm, _), run in runs.items():
            found.setdefault((algorithm, name), []).append(options.output / run.name)
    return found


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


def count_affordable(options: argparse.Namespace, algorithm: str, first: Run) -> int:
    """Transitions in the budget of seconds at the speed of the first training.

    Neither its evaluations nor its demonstrations count as time.
    """
    seconds = read(options.output / first.name / TIMES_FILE)["seconds_training"]
    demonstrated = count_demonstrations(algorithm, options.transitions)
    collected = options.seconds * (options.transitions - demonstrated) / seconds
    return demonstrated + max(100, int(round(collected, -2)))


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
    return measure(make_policy(task.name, scenario, SEED), scenario, options)


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
    found = measure(final, scenario, options) | {"asked": asked}
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


def is_good(columns: Mapping[str, Any]) -> bool:
    """Whether the maneuvers are cheap and succeed: the cost of a few that complete says nothing."""
    if np.mean(columns["success_rate"]) < GOOD_SUCCESS:
        return False
    costs = np.array([columns["return"], columns["optimal_return"]], np.float64)
    total, least = costs[:, np.isfinite(costs).all(axis=0)].sum(axis=1)
    return bool(total >= GOOD_RATIO * least)


def measure(policy: Policy, scenario: Scenario, options: argparse.Namespace) -> dict[str, Any]:
    """Each maneuver's metrics, and the time of a decision [us]."""
    seen: list[NDArray[np.float32]] = []

    def watch(observations: NDArray[np.float32]) -> NDArray[np.float64]:
        if sum(map(len, seen)) < max(BATCHES):
            seen.append(observations.copy())
        return policy(observations)

    columns = drive(watch, scenario, options.maneuvers, SEED)
    observations = np.concatenate(seen)
    times = {}
    for size in BATCHES:
        rows = np.resize(observations, (size, observations.shape[1]))
        timer = timeit.Timer(lambda rows=rows: policy(rows))  # type: ignore[misc]
        timer.timeit(3)
        number = ceil(TIMED / timer.timeit(1))
        times[f"microseconds_of_{size}"] = 1e6 * min(timer.repeat(5, number)) / number
    return {"maneuvers": columns, **times}


def drive(policy: Policy, scenario: Scenario, number: int, seed: int) -> dict[str, list[Any]]:
    """The road of each maneuver, and its metrics; None where one is not defined."""
    maneuvers = run_maneuvers(scenario, policy, number, seed=seed)
    measured, _ = measure_each(maneuvers, scenario)
    keys = [key for key, *_ in COLUMNS if key in AVERAGES]
    values: dict[str, list[float]] = {key: [*map(AVERAGES[key], measured)] for key in keys}
    values["return"] = [row.return_ for row in measured]
    values["optimal_return"] = [row.optimal_return for row in measured]
    found = {
        key: [value if np.isfinite(value) else None for value in column]
        for key, column in values.items()
    }
    return {"road": [one.env for one in maneuvers], **found}


def estimate(seeds: Sequence[Mapping[str, Any]], key: str, divisor: str | None = None) -> Estimate:
    """Mean of a column over all maneuvers of all seeds, or the ratio of two columns' sums."""
    samples = []
    for columns in seeds:
        upper = columns[key]
        lower = [1.0] * len(upper) if divisor is None else columns[divisor]
        samples.append((upper, lower, columns["road"]))
    return estimate_over_seeds(samples, is_rate=key.endswith("_rate"))


def summarise(name: str, budget: str, found: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The row of an algorithm and a budget, or of a policy without learning."""
    seeds = [one["maneuvers"] for one in found]
    row: dict[str, Any] = {"policy": name, "budget": budget, "seeds": len(seeds)}
    for key, *_ in COLUMNS:
        columns = ("return", "optimal_return") if key == "cost_ratio" else (key, None)
        row[key] = asdict(estimate(seeds, *columns))
    row["success_of_seeds"] = [float(np.mean(one["success_rate"])) for one in seeds]
    for key in FIGURES:
        row[key] = [one.get(key) for one in found]
    return row


def write_rows(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """One line a row; of each metric value, low and high."""
    flat = []
    for row in rows:
        cells: dict[str, Any] = {}
        for key, value in row.items():
            if isinstance(value, dict):
                cells |= {f"{key}_{part}": number for part, number in value.items()}
            else:
                cells[key] = " ".join(map(str, value)) if isinstance(value, list) else value
        flat.append(cells)
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, flat[0])
        writer.writeheader()
        writer.writerows(flat)


def format_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """The rows in Markdown."""
    first, *others = (title for _, title, *_ in COLUMNS)
    titles = ["policy", "budget", first, "by seed", *others]
    titles += [
        "transitions",
        "training [s]",
        f"transitions to {GOOD_RATIO}",
        "decision [µs], 1 / 64",
    ]
    lines = [titles, ["---"] * len(titles)]
    for row in rows:
        estimates = [
            format_estimate(row[key], factor, decimals) for key, _, factor, decimals in COLUMNS
        ]
        one, many = (f"{np.mean(row[f'microseconds_of_{size}']):.0f}" for size in BATCHES)
        is_trained = bool(row["budget"])
        needed = ["never" if one is None else f"{one:,}" for one in row["transitions_to_good"]]
        by_seed, figures = "-", ["-"] * 3
        if is_trained:
            by_seed = ", ".join(f"{100.0 * rate:.1f}" for rate in row["success_of_seeds"])
            figures = [
                f"{np.mean(row['transitions']):,.0f}",
                f"{np.mean(row['training_seconds']):.0f}",
                ", ".join(needed),
            ]
        name = row["policy"]
        success, *others = estimates
        cells = [name, row["budget"] or "-", success, by_seed, *others, *figures]
        lines.append([*cells, f"{one} / {many}"])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def check_docs(path: Path | None) -> None:
    """Refuse a file without the place of the table.

    Raises:
        OSError, ValueError: it cannot be read, or has no such place.
    """
    if path is None:
        return
    text = path.read_text(encoding="utf-8")
    if any(text.count(mark) != 1 for mark in MARKS):
        raise ValueError(f"--docs {path}: must have the lines {MARKS[0]} and {MARKS[1]} once each")


if __name__ == "__main__":
    main()
