"""Does a lane changer gain from seeing more? NAF with memory, with a grid, and with neither.

python agents/memory/compare.py [--scenario hidden] [--views plain stacked gru grid]
    [--seeds 0 1 2] [--transitions 800000] [--processes 1] --output DIR

plain is the scenario's own observation; stacked has the last 8 observations; gru reads these with a
GRU; grid has an occupancy grid beside the features, read by a convolution. Each training is
agents/naf/train.py with the recipe interactive and this number of transitions, in DIR/VIEW_SEED.
What is finished is kept, so the same command carries on a comparison that was interrupted. The
table is of all finished trainings in DIR.
"""

import argparse
import csv
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from marl_lanes.evaluation.intervals import Estimate, estimate_mean, estimate_ratio
from marl_lanes.evaluation.tables import format_estimate
from marl_lanes.files import write_json, write_text
from marl_lanes.scenario import load_scenario
from marl_lanes.scenario.messages import shown
from marl_lanes.scenario.yaml_files import format_yaml
from marl_lanes.studies import Run, carry_out, is_finished
from marl_lanes.terminal import lenient_streams
from marl_lanes.training.command_line import Parser, refusing
from marl_lanes.training.run_folder import EVALUATION_FILE

TRAIN = "agents/naf/train.py"
NUM_STACKED = 8
VIEWS: Mapping[str, tuple[Mapping[str, Any], str]] = {
    "plain": ({}, "none"),
    "stacked": ({"num_stacked": NUM_STACKED}, "none"),
    "gru": ({"num_stacked": NUM_STACKED}, "gru"),
    "grid": ({"grid": {}}, "grid"),
}
"""What is set in the scenario's observation, and the encoder."""
STAGE_ONE = 0.375
"""Of the transitions. After a shorter one the policy is lost as soon as mu learns."""
SETTINGS: Mapping[str, Any] = {
    "demonstrations.num_transitions": 0,
    "network.mu": "cascade+idm",
    "network.hidden_sizes": "[64,64]",
    "replay.capacity": 524_288,
    "optimizer.mu_learning_rate": 0.0002,
    "optimizer.longitudinal_learning_rate": 0.0004,
    "evaluation.criterion": "success_rate",
}
"""Where it differs from the recipe: nothing is demonstrated, so that all that a policy knows of the
others it has learned; mu moves faster, and nothing is forgotten."""
NUM_SAVED = 8
"""Models, of which the best becomes the final one."""
NUM_MANEUVERS = 200
"""In the evaluation of each of them."""
MAX_COUNT = 10**9


class Column(NamedTuple):
    """A number of the table."""

    title: str
    factor: float
    decimals: int


COLUMNS = {
    "success": Column("success [%]", 100.0, 1),
    "missed": Column("missed [%]", 100.0, 1),
    "aborts": Column("aborts a maneuver", 1.0, 2),
    "time": Column("time to complete [s]", 1.0, 2),
    "cost_ratio": Column("cost ratio", 1.0, 2),
    "reward": Column("episode reward", 1.0, 1),
}


@lenient_streams()
def main(arguments: Sequence[str] | None = None) -> None:
    """Train what is not trained, write, print."""
    options = parse(arguments)
    with refusing():
        write_scenarios(options.scenario, options.output)
        runs = [
            make_run(view, seed, options.transitions, options.output)
            for seed in options.seeds
            for view in options.views
        ]
        is_over = carry_out(runs, options.output, num_processes=options.processes)
        found = summarise(options.output)
        write_json(options.output / "comparison.json", found)
    print(table(found))
    if not is_over:
        print("interrupted: the same command goes on")


def write_scenarios(source: str, folder: Path) -> None:
    """The scenario with the observation of each view."""
    for view, (observation, _) in VIEWS.items():
        scenario = load_scenario(source, {"observation": observation})
        text = format_yaml(scenario.model_dump(mode="json"))
        write_text(folder / f"{view}.yaml", text)


def make_run(view: str, seed: int, transitions: int, folder: Path) -> Run:
    """The training of a view."""
    _, encoder = VIEWS[view]
    fields = {
        "recipe": "interactive",
        "scenario": folder / f"{view}.yaml",
        "network.encoder": encoder,
        "seed": seed,
        "collector.total_transitions": transitions,
        **SETTINGS,
        "optimizer.pretraining_transitions": round(STAGE_ONE * transitions),
        "exploration.annealing_transitions": transitions,
        "evaluation.save_interval": max(1, transitions // NUM_SAVED),
        "evaluation.num_maneuvers": NUM_MANEUVERS,
        "evaluation.record": "false",
    }
    return Run(f"{view}_{seed}", TRAIN, tuple(f"{name}={value}" for name, value in fields.items()))


def summarise(folder: Path) -> dict[str, Any]:
    """What each view achieves, over the maneuvers of all its finished trainings.

    All are evaluated on the same roads; so a road with all its maneuvers, of all seeds, is what an
    interval's resamples draw.
    """
    result = {}
    for view in VIEWS:
        paths = [path for path in sorted(folder.glob(f"{view}_*")) if is_finished(path)]
        if paths:
            rows = [row for path in paths for row in read_maneuvers(path)]
            told = [json.loads((path / EVALUATION_FILE).read_text("utf-8")) for path in paths]
            rewards = [one["mean_episode_reward"] for one in told]
            result[view] = {
                **{name: vars(value) for name, value in estimate(rows).items()},
                "reward": vars(Estimate(float(np.mean(rewards)), min(rewards), max(rewards))),
                "seeds": {
                    path.name.rpartition("_")[2]: one["success_rate"]
                    for path, one in zip(paths, told, strict=True)
                },
            }
    return result


def read_maneuvers(run: Path) -> list[dict[str, str]]:
    """The maneuvers of a training's final evaluation."""
    with (run / "final_maneuvers.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def estimate(rows: Sequence[Mapping[str, str]]) -> dict[str, Estimate]:
    """The numbers of the table over maneuvers, but for the reward."""
    roads = [int(row["road"]) for row in rows]
    is_missed = [row["outcome"] == "missed" for row in rows]
    times = [
        float(row["end_time"]) - float(row["command_time"])
        if row["outcome"] == "completed"
        else np.nan
        for row in rows
    ]
    costs, optima = (
        [float(row[name]) if row["cost_ratio"] else np.nan for row in rows]
        for name in ("return", "optimal_return")
    )
    return {
        "success": estimate_mean([int(row["is_success"]) for row in rows], roads, is_rate=True),
        "missed": estimate_mean(is_missed, roads, is_rate=True),
        "aborts": estimate_mean([int(row["num_aborts"]) for row in rows], roads, is_rate=False),
        "time": estimate_mean(times, roads, is_rate=False),
        "cost_ratio": estimate_ratio(costs, optima, roads),
    }


def table(found: Mapping[str, Any]) -> str:
    """The numbers as a table in Markdown; of the reward and the last column the range of seeds."""
    titles = ["view", *(column.title for column in COLUMNS.values()), "success of each seed [%]"]
    lines = [titles, ["---"] * len(titles)]
    for view, one in found.items():
        cells = [
            format_estimate(one[name], column.factor, column.decimals)
            for name, column in COLUMNS.items()
        ]
        seeds = ", ".join(f"{100.0 * rate:.1f}" for rate in one["seeds"].values())
        lines.append([view, *cells, seeds])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """The command line."""
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenario", default="hidden", help="with two actions (default: hidden)")
    parser.add_argument(
        "--views", nargs="+", choices=list(VIEWS), default=list(VIEWS), help="default: all"
    )
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2], help="default: 0 1 2")
    parser.add_argument(
        "--transitions", type=int, default=800_000, help="of each training (default: 800000)"
    )
    parser.add_argument("--processes", type=int, default=1, help="trainings at a time (default: 1)")
    parser.add_argument("--output", type=Path, required=True, help="folder of the comparison")
    options = parser.parse_args(arguments)
    for name in ("transitions", "processes"):
        if not 1 <= getattr(options, name) <= MAX_COUNT:
            value = shown(getattr(options, name))
            parser.error(f"--{name} {value}: must be at least 1, at most {MAX_COUNT}")
    for name in ("views", "seeds"):
        if len(set(getattr(options, name))) < len(getattr(options, name)):
            parser.error(f"--{name} {shown(getattr(options, name))}: must name each once")
    return options


if __name__ == "__main__":
    main()
