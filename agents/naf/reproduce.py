"""The paper's experiment with the paper's numbers: its figures, and a table beside its statements.

python agents/naf/reproduce.py [--output runs/reproduction] [--seeds 0 1 2]
    [--scenarios touch paper] [--processes N] [--only RUN ...] [--report] [--quick]
    [--figures FOLDER] [--docs FILE]

Trains recipe=paper for every scenario and seed, and the first of them with gamma 0.99 as well. The
same command goes on after an interruption. --quick has the same form on a budget of seconds: it
shows that everything works, and its numbers mean nothing.
"""

import argparse
import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from marl_lanes.evaluation.figures import draw_maneuver
from marl_lanes.evaluation.linear_program import Program
from marl_lanes.evaluation.metrics import evaluate
from marl_lanes.evaluation.replay import DEVIATION, LATERAL_SPEED, YAW_RATE, Replay
from marl_lanes.evaluation.rollout import run_maneuvers
from marl_lanes.evaluation.seeds import draw_losses, draw_models, draw_returns
from marl_lanes.files import replacing, write_json, write_text
from marl_lanes.naf.lateral import PaperMu
from marl_lanes.report.documents import check_document, format_table, insert_tables
from marl_lanes.report.statements import (
    FINAL,
    PAPERS_STAGE_ONE,
    drive_saved_models,
    find_saved_models,
    measure_run,
    read_config,
    tabulate_statements,
)
from marl_lanes.scenario import Scenario, load_scenario
from marl_lanes.scenario.messages import shown
from marl_lanes.studies import Run, carry_out
from marl_lanes.terminal import lenient_streams
from marl_lanes.traffic.parameters import make_parameters
from marl_lanes.training.command_line import Parser, refusing
from marl_lanes.training.config import ConfigError
from marl_lanes.training.failures import ending

PROGRAM = "agents/naf/train.py"
# With so few steps a batch has about 20 updates: the loss has a row for about every 20.
ARGUMENTS = (
    "recipe=paper",
    "num_threads=1",
    "collector.steps_per_batch=5",
    "evaluation.record=false",
)
QUICK = (
    "network.hidden_sizes=[8]",
    "collector.total_transitions=400",
    "optimizer.pretraining_transitions=200",
    "exploration.annealing_transitions=400",
    "evaluation.save_interval=200",
    "evaluation.num_maneuvers=2",
    "evaluation.final_num_maneuvers=2",
)
OTHER_GAMMA = 0.99
"""Of one more training."""
GAMMAS = (0.95, OTHER_GAMMA, 0.998)
MANEUVER_TITLE = "The same maneuver with the first saved and the final model"
SPEEDS = (16.0, 20.0, 24.0, 28.0)
"""[m/s] Of the changes whose discounted cost is shown."""
LONGEST = 120
"""[steps] Of these changes."""
TIMES = (2.0, 2.4, 2.8, 3.4)
"""[s] T of Eq. 7. The paper does not give it; 3.4 s is where the training starts here."""
TABLES = ("statements", "discounts", "gammas", "maneuvers")

Rows = list[dict[str, Any]]
FloatArray = NDArray[np.float64]


@lenient_streams()
def main(arguments: Sequence[str] | None = None) -> None:
    """Train, measure, draw, write."""
    options = parse(arguments)
    torch.set_num_threads(1)
    with ending(options.output):
        with refusing():
            scenarios = {name: load_scenario(name) for name in options.scenarios}
            if options.docs is not None:
                check_document(options.docs, TABLES)
            runs = choose(plan(options), options.only)
            if options.report:
                check_begun(options)
                is_whole = True
            else:
                is_whole = carry_out(runs, options.output, num_processes=options.processes)
        if not is_whole:
            print("interrupted; the same command goes on")
        elif options.report or not options.only:
            report(options, scenarios)


def plan(options: argparse.Namespace) -> list[Run]:
    """The trainings, that with another gamma last."""
    given = (*ARGUMENTS, *(QUICK if options.quick else ()))
    runs = [
        Run(f"{scenario}_{seed}", PROGRAM, (*given, f"scenario={scenario}", f"seed={seed}"))
        for scenario in options.scenarios
        for seed in options.seeds
    ]
    name, program, first = runs[0]
    return [*runs, Run(f"{name}_gamma", program, (*first, f"loss.gamma={OTHER_GAMMA}"))]


def choose(runs: list[Run], names: Sequence[str]) -> list[Run]:
    """The runs of these names, all if there are none.

    Raises:
        ConfigError: there is no run of a name.
    """
    known = [run.name for run in runs]
    for name in names:
        if name not in known:
            raise ConfigError(f"--only {shown(name)}: must be among {', '.join(known)}")
    return [run for run in runs if not names or run.name in names]


def find_begun(options: argparse.Namespace) -> dict[str, list[Path]]:
    """The runs that have models to compare, by scenario."""
    paths = {
        name: [options.output / f"{name}_{seed}" for seed in options.seeds]
        for name in options.scenarios
    }
    begun = {name: [path for path in found if is_begun(path)] for name, found in paths.items()}
    return {name: found for name, found in begun.items() if found}


def is_begun(path: Path) -> bool:
    """Whether a run has models to compare."""
    return len(find_saved_models(path)) > 1


def check_begun(options: argparse.Namespace) -> None:
    """Refuse a report of nothing.

    Raises:
        ConfigError: no run has two saved models.
    """
    if not find_begun(options):
        raise ConfigError(
            f"output {shown(str(options.output))}: must have a training with two saved models"
        )


def report(options: argparse.Namespace, scenarios: Mapping[str, Scenario]) -> None:
    """Measure the runs as far as they are; write numbers, tables and figures."""
    output: Path = options.output
    figures: Path = options.figures or output / "figures"
    folders = find_begun(options)
    rows: Rows = []
    for name, paths in folders.items():
        driven = [drive_saved_models(path, scenarios[name]) for path in paths]
        for path, models in zip(paths, driven, strict=True):
            rows.append(measure_run(path, models, scenarios[name]))
        starts, ends = ([models[index][0] for models in driven] for index in (0, 1))
        stem = figures / f"reproduction_maneuver_{scenarios[name].name}"
        shown_models = dict(zip(label_models(paths[0]), (starts, ends), strict=True))
        draw_maneuver(stem, MANEUVER_TITLE, shown_models, scenarios[name])
    name, seed = options.scenarios[0], options.seeds[0]
    path = output / f"{name}_{seed}_gamma"
    others: Rows = []
    if is_begun(path):
        models = drive_saved_models(path, scenarios[name])
        others.append(measure_run(path, models, scenarios[name]))
    (first, *_), *_ = folders.values()
    config = read_config(first)
    stage_one = config["optimizer"]["pretraining_transitions"]
    for title, draw in (("loss", draw_losses), ("returns", draw_returns), ("models", draw_models)):
        draw(figures / f"reproduction_{title}", folders, stage_one)
    discounts = [row for key, one in scenarios.items() for row in weigh_discounts(key, one)]
    number = config["evaluation"]["num_maneuvers"]
    counts = [row for key, one in scenarios.items() for row in count_by_time(key, one, number)]
    finals = [
        {key: one[key] for key in ("scenario", "seed", "gamma", *FINAL)}
        for one in (*rows, *others)
        if one["success_rate"] is not None
    ]
    tables = {
        "statements": tabulate_statements(rows),
        "discounts": format_table(discounts),
        "gammas": format_table(finals) if finals else "No training has come to its end.\n",
        "maneuvers": format_table(counts),
    }
    rows += others
    with (
        replacing(output / "results.csv") as temporary,
        temporary.open("w", newline="", encoding="utf-8") as file,
    ):
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    results = {"runs": rows, "discounts": discounts, "maneuvers": counts}
    write_json(output / "results.json", results)
    write_text(output / "results.md", "\n".join(tables.values()))
    if options.docs is not None:
        insert_tables(options.docs, tables)
    print(tables["statements"])


def label_models(folder: Path) -> tuple[str, str]:
    """What the first and the last saved model of a run are called."""
    saved = find_saved_models(folder)
    first, last = (int(path.stem.rpartition("_")[2]) for path in (saved[0], saved[-1]))
    return f"{first:,} transitions", f"{last:,} transitions"


def weigh_discounts(name: str, scenario: Scenario) -> Rows:
    """The discounted cost of never changing lanes, and of the cheapest change.

    Means over SPEEDS, each constant; the motion is linear in the actions, with sin psi = psi.
    """
    size = LONGEST
    rows = []
    for gamma in GAMMAS:
        found = []
        for speed in SPEEDS:
            program = make_program(scenario, speed, gamma)
            costs = [program.solve(count)[0] for count in range(1, size + 1)]
            best = int(np.argmin(costs))
            peak = np.abs(program.solve(best + 1)[1]).max()
            found.append((costs[best], best + 1, peak))
        cost, steps, peak = np.mean(found, axis=0).tolist()
        deviation = scenario.road.lane_width / scenario.reward.average_deviation
        never = scenario.reward.deviation_weight * deviation / (1.0 - gamma)
        rows.append(
            {
                "scenario": name,
                "gamma": gamma,
                "cost of never changing": never,
                "cost of the cheapest change": cost,
                "saved by changing [%]": 100.0 * (1.0 - cost / never),
                "its steps": steps,
                "its peak yaw acceleration [rad/s²]": peak,
            }
        )
    return rows


def make_program(scenario: Scenario, speed: float, gamma: float) -> Program:
    """The linear programs of a change of one lane at a constant speed."""
    replay = Replay(
        make_parameters(scenario),
        np.full(LONGEST, speed),
        initial_speed=speed,
        position=0.0,
        lateral_position=0.0,
        yaw=0.0,
        yaw_rate=0.0,
        direction=1,
        deviation=scenario.road.lane_width,
    )
    replay.follow(np.zeros(LONGEST))
    free, response = replay.linearise(LONGEST)
    bounds = np.full(3, np.inf)
    completion = scenario.completion
    bounds[DEVIATION] = completion.max_deviation
    bounds[LATERAL_SPEED] = completion.max_lateral_speed or np.inf
    bounds[YAW_RATE] = completion.max_yaw_rate or np.inf
    bound = scenario.action.max_yaw_acceleration
    return Program(free, response, bounds, bound, scenario.reward, gamma=gamma)


def count_by_time(name: str, scenario: Scenario, num_maneuvers: int) -> Rows:
    """How many maneuvers 200,000 steps have when mu is Eq. 6 and 7 with constants, by T."""
    features: list[str] = list(scenario.observation.features)
    columns = [features.index(name) for name in PaperMu.needs]
    rows = []
    for time in TIMES:

        def steer(observations: NDArray[np.float32], time: float = time) -> FloatArray:
            speed, deviation, yaw = observations[:, columns].T.astype(np.float64)
            wanted = (deviation / time - speed * yaw) / time
            action = PaperMu.initial_a_max * np.tanh(PaperMu.initial_sensitivity * wanted)
            return np.asarray(action[:, np.newaxis])

        maneuvers = run_maneuvers(scenario, steer, num_maneuvers)
        steps = float(np.mean([len(one.trace) for one in maneuvers]))
        found = evaluate(maneuvers, scenario, with_optimum=False)
        rows.append(
            {
                "scenario": name,
                "T [s]": time,
                "steps a maneuver": steps,
                "maneuvers in 200,000 steps": round(PAPERS_STAGE_ONE / steps),
                "completed [%]": 100.0 * found["completion_rate"],
                "success [%]": 100.0 * found["success_rate"],
            }
        )
    return rows


def parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """The command line."""
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("runs/reproduction"), help="folder")
    parser.add_argument("--scenarios", nargs="+", default=["touch", "paper"], metavar="NAME")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2], metavar="N")
    parser.add_argument("--processes", type=int, default=1, help="trainings at a time (default: 1)")
    parser.add_argument(
        "--only",
        nargs="+",
        default=[],
        metavar="RUN",
        help="carry out these trainings alone, and report nothing: SCENARIO_SEED, or the first "
        "one's with _gamma",
    )
    parser.add_argument(
        "--report",
        action="store_true",
        help="train nothing; report on the trainings that are there, also on unfinished ones",
    )
    parser.add_argument("--quick", action="store_true", help="a budget of seconds")
    parser.add_argument("--figures", type=Path, help="their folder (default: OUTPUT/figures)")
    parser.add_argument("--docs", type=Path, metavar="FILE", help="put the tables into it, too")
    return parser.parse_args(arguments)


if __name__ == "__main__":
    main()
