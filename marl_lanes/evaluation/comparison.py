"""An algorithm in a comparison: what each of its policies achieves, its row, and the table."""

import csv
import timeit
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from marl_lanes.evaluation.driving import Policy
from marl_lanes.evaluation.intervals import Estimate, estimate_over_seeds
from marl_lanes.evaluation.metrics import AVERAGES, measure_each
from marl_lanes.evaluation.rollout import run_maneuvers
from marl_lanes.evaluation.tables import format_estimate
from marl_lanes.files import replacing
from marl_lanes.scenario import Scenario

GOOD_RATIO, GOOD_SUCCESS = 1.15, 0.98
"""A model counts as good that has this cost ratio at most, and this success rate at least."""

BATCHES = (1, 64)
"""Observations in a call of a policy, for the time of a decision."""

TIMED = 0.05
"""[s] In which decisions are timed together; the fastest of five times counts."""

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


def is_good(columns: Mapping[str, Any]) -> bool:
    """Whether the maneuvers are cheap and succeed: the cost of a few that complete says nothing."""
    if np.mean(columns["success_rate"]) < GOOD_SUCCESS:
        return False
    costs = np.array([columns["return"], columns["optimal_return"]], np.float64)
    total, least = costs[:, np.isfinite(costs).all(axis=0)].sum(axis=1)
    return bool(total >= GOOD_RATIO * least)


def measure(policy: Policy, scenario: Scenario, number: int, seed: int) -> dict[str, Any]:
    """Each maneuver's metrics, and the time of a decision [us].

    Args:
        policy: of the lane changers.
        scenario: its traffic.
        number: of maneuvers.
        seed: of their traffic.
    """
    seen: list[NDArray[np.float32]] = []

    def watch(observations: NDArray[np.float32]) -> NDArray[np.float64]:
        if sum(map(len, seen)) < max(BATCHES):
            seen.append(observations.copy())
        return policy(observations)

    columns = drive(watch, scenario, number, seed)
    observations = np.concatenate(seen)
    times = {}
    for size in BATCHES:
        rows = np.resize(observations, (size, observations.shape[1]))
        timer = timeit.Timer(lambda rows=rows: policy(rows))  # type: ignore[misc]
        timer.timeit(3)
        calls = ceil(TIMED / timer.timeit(1))
        times[f"microseconds_of_{size}"] = 1e6 * min(timer.repeat(5, calls)) / calls
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


def format_comparison(rows: Sequence[Mapping[str, Any]]) -> str:
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
