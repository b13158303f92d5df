"""What the paper says of its training, beside the same numbers of runs of recipe paper."""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from marl_lanes.evaluation.figures import read_table
from marl_lanes.evaluation.metrics import evaluate
from marl_lanes.evaluation.rollout import Maneuver, run_maneuvers
from marl_lanes.naf.checkpoint import greedy_policy
from marl_lanes.report.documents import Cell, format_table
from marl_lanes.scenario import Scenario
from marl_lanes.scenario.yaml_files import read_yaml
from marl_lanes.traffic.machine.state import Outcome
from marl_lanes.training.checkpoint import load_policy
from marl_lanes.training.config import CONFIG_FILE
from marl_lanes.training.run_folder import CHECKPOINTS_FOLDER, EVALUATION_FILE

PAPERS_MANEUVERS, PAPERS_STAGE_ONE = 6500, 200_000
"""Maneuvers in so many steps."""
FINAL = ("success_rate", "completion_rate", "cost_ratio", "mean_return", "mean_num_steps")
"""Of the final evaluation."""

FloatArray = NDArray[np.float64]


def read_config(folder: Path) -> dict[str, Any]:
    """A finished run's configuration, as plain values."""
    config: dict[str, Any] = read_yaml(folder / CONFIG_FILE)
    return config


def find_saved_models(folder: Path) -> list[Path]:
    """A run's saved models, the first one first."""
    return sorted((folder / CHECKPOINTS_FOLDER).glob("step_*.pt"))


def drive_saved_models(folder: Path, scenario: Scenario) -> tuple[list[Maneuver], list[Maneuver]]:
    """Maneuvers of a run's first and last saved model, frozen, on the same traffic."""
    settings = read_config(folder)["evaluation"]
    saved = find_saved_models(folder)
    first, last = (
        run_maneuvers(
            scenario,
            greedy_policy(load_policy(path, scenario).network),
            settings["num_maneuvers"],
            seed=settings["seed"] + 1,
        )
        for path in (saved[0], saved[-1])
    )
    return first, last


def measure_run(
    folder: Path, models: tuple[list[Maneuver], list[Maneuver]], scenario: Scenario
) -> dict[str, Any]:
    """What the paper says of its training, in numbers of a run; None where nothing defines it.

    Args:
        folder: of the run, which may not have come to its end.
        models: of ``drive_saved_models``.
        scenario: of the maneuvers.

    Raises:
        OSError, ScenarioError: the run's files cannot be read.
    """
    maneuvers, metrics, saved = (
        read_table(folder / f"{table}.csv") for table in ("maneuvers", "metrics", "evaluations")
    )
    config = read_config(folder)
    stage_one = config["optimizer"]["pretraining_transitions"]
    is_completed = maneuvers["outcome"] == Outcome.COMPLETED
    is_early = maneuvers["transitions"] <= stage_one
    num_early = int(is_early.sum())
    total = metrics["transitions"][-1]

    def tenth(table: Mapping[str, FloatArray], number: int) -> NDArray[np.bool_]:
        """Of the training, from 0 to 9."""
        tenths = np.minimum(9, 10 * table["transitions"] // total)
        return np.asarray(tenths == number)

    def mean_return(number: int) -> float | None:
        return _mean(maneuvers["return"][is_completed & tenth(maneuvers, number)])

    first, last = (evaluate(one, scenario, with_optimum=False) for one in models)
    # The final model has a row more.
    returns = saved["mean_return"][: len(find_saved_models(folder))]
    rises = np.diff(returns) > 0.0
    path = folder / EVALUATION_FILE
    final = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    return {
        "scenario": config["scenario"],
        "seed": config["seed"],
        "gamma": config["loss"]["gamma"],
        "transitions": float(total),
        "maneuvers": num_early,
        "maneuvers_wanted": PAPERS_MANEUVERS * stage_one / PAPERS_STAGE_ONE,
        "steps_a_maneuver": stage_one / num_early if num_early else None,
        "completed_early": _mean(is_completed[is_early]),
        "loss_first": _mean(metrics["loss"][tenth(metrics, 0)]),
        "loss_last": _mean(metrics["loss"][tenth(metrics, 9)]),
        "return_first": mean_return(0),
        "return_before": mean_return(8),
        "return_last": mean_return(9),
        "completed_first": _mean(is_completed[tenth(maneuvers, 0)]),
        "completed_last": _mean(is_completed[tenth(maneuvers, 9)]),
        "model_first": _mean(returns[:1]),
        "model_last": _mean(returns[-1:]),
        "model_rises": float(rises.mean()) if rises.size else None,
        "success_first": first["success_rate"],
        "success_last": last["success_rate"],
        "completion_first": first["completion_rate"],
        "completion_last": last["completion_rate"],
        "peak_acceleration_first": first["mean_peak_yaw_acceleration"],
        "peak_acceleration_last": last["mean_peak_yaw_acceleration"],
        "peak_rate_first": first["mean_peak_yaw_rate"],
        "peak_rate_last": last["mean_peak_yaw_rate"],
        **{key: final.get(key) for key in FINAL},
    }


class Statement(NamedTuple):
    """What the paper says, and how it shows in the numbers of a run."""

    words: str
    measures: tuple[tuple[str, str, float], ...]
    """Of each number its name, its key, and the factor with which it is shown."""
    criterion: str
    holds: Callable[[Mapping[str, Any]], bool]
    """Given a run's numbers, none of which is missing."""


STATEMENTS = (
    Statement(
        "around 6,500 maneuvers in the first 200,000 steps",
        (
            ("maneuvers in stage one", "maneuvers", 1.0),
            ("steps a maneuver", "steps_a_maneuver", 1.0),
            ("completed of these [%]", "completed_early", 100.0),
        ),
        "within 10 %",
        lambda run: abs(run["maneuvers"] / run["maneuvers_wanted"] - 1.0) <= 0.1,
    ),
    Statement(
        "Figure 6(a): an obvious convergence of the loss",
        (("loss, first tenth", "loss_first", 1.0), ("loss, last tenth", "loss_last", 1.0)),
        "less than half of the first tenth's is left",
        lambda run: run["loss_last"] < 0.5 * run["loss_first"],
    ),
    Statement(
        "Figure 6(b): rewards go up and reach a roughly steady level",
        (
            ("return with noise, first tenth", "return_first", 1.0),
            ("last tenth but one", "return_before", 1.0),
            ("last tenth", "return_last", 1.0),
            ("completed, first tenth [%]", "completed_first", 100.0),
            ("completed, last tenth [%]", "completed_last", 100.0),
        ),
        "the last is higher than the first, and within 5 % of the one before",
        lambda run: (
            run["return_last"] > run["return_first"]
            and abs(run["return_last"] / run["return_before"] - 1.0) <= 0.05
        ),
    ),
    Statement(
        "Figure 7: the averaged total reward of the saved models increases steadily",
        (
            ("return, first model", "model_first", 1.0),
            ("return, last model", "model_last", 1.0),
            ("steps from model to model that rise [%]", "model_rises", 100.0),
            ("success, first model [%]", "success_first", 100.0),
            ("success, last model [%]", "success_last", 100.0),
        ),
        "the last is higher than the first, and three quarters of the steps rise",
        lambda run: run["model_last"] > run["model_first"] and run["model_rises"] >= 0.75,
    ),
    Statement(
        "Figure 8: the last model's curves change moderately compared with the first one's",
        (
            ("peak yaw acceleration, first model [rad/s²]", "peak_acceleration_first", 1.0),
            ("last model [rad/s²]", "peak_acceleration_last", 1.0),
            ("peak yaw rate, first model [rad/s]", "peak_rate_first", 1.0),
            ("last model [rad/s]", "peak_rate_last", 1.0),
            ("completed, first model [%]", "completion_first", 100.0),
            ("completed, last model [%]", "completion_last", 100.0),
        ),
        "both peaks are lower, as means over the completed maneuvers",
        lambda run: (
            run["peak_acceleration_last"] < run["peak_acceleration_first"]
            and run["peak_rate_last"] < run["peak_rate_first"]
        ),
    ),
)


def tabulate_statements(rows: Sequence[Mapping[str, Any]]) -> str:
    """The statements beside the medians of the seeds, with their range, as a Markdown table.

    Args:
        rows: of ``measure_run``, a scenario's seeds together.
    """
    names = dict.fromkeys(row["scenario"] for row in rows)
    runs = {name: [row for row in rows if row["scenario"] == name] for name in names}
    trained = {
        name: _summarise([run["transitions"] for run in found], 1e-3)
        for name, found in runs.items()
    }
    lines: list[dict[str, Cell]] = [{"the paper": "", "here": "transitions [1,000]", **trained}]
    for statement in STATEMENTS:
        words = statement.words
        for label, key, factor in statement.measures:
            cells = {
                name: _summarise([run[key] for run in found], factor)
                for name, found in runs.items()
            }
            lines.append({"the paper": words, "here": label, **cells})
            words = ""
        keys = [key for _, key, _ in statement.measures]
        cells = {}
        for name, found in runs.items():
            whole = [run for run in found if all(run[key] is not None for key in keys)]
            number = sum(map(statement.holds, whole))
            cells[name] = f"**holds in {number} of {len(found)}**" if whole else "**not defined**"
        lines.append({"the paper": "", "here": f"holds if {statement.criterion}", **cells})
    return format_table(lines)


def _summarise(values: Sequence[float | None], factor: float) -> str:
    """Median and range, and of how many seeds if not of all."""
    known = [factor * value for value in values if value is not None]
    if not known:
        return "-"
    text = f"{np.median(known):.4g}"
    if len(known) > 1:
        text += f" [{min(known):.4g}, {max(known):.4g}]"
    return text if len(known) == len(values) else f"{text} ({len(known)} of {len(values)} seeds)"


def _mean(values: NDArray[Any]) -> float | None:
    """Of the finite ones; None if there is none."""
    known = np.asarray(values, np.float64)
    known = known[np.isfinite(known)]
    return float(known.mean()) if known.size else None
