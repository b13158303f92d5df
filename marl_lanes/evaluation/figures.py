"""The report's figures: the paper's Figures 6 to 8 for a run."""

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from marl_lanes.evaluation.rollout import Maneuver
from marl_lanes.scenario import Scenario

RUNNING_MEAN = 200
"""Maneuvers in the running mean of the returns."""

_BLUE, _RED, _GREY = "#1f5fa8", "#c23b22", "#9aa0a6"


def draw_training(run: Path, pretraining_transitions: int, optimal_return: float | None) -> None:
    """Loss, return per maneuver and mean return per saved model, from the run's tables.

    Args:
        run: the run folder; the pictures go to its ``figures``.
        pretraining_transitions: where stage one ends.
        optimal_return: mean return of the optimum, drawn as a line; None for no line.
    """
    metrics = _read(run / "metrics.csv")
    figure, axes = _new_figure("Loss (Eq. 8)", "transitions", "mean squared error")
    has_loss = np.isfinite(metrics["loss"])
    axes.plot(metrics["transitions"][has_loss], metrics["loss"][has_loss], color=_BLUE, lw=0.8)
    axes.set_yscale("log")
    _mark_stage(axes, pretraining_transitions)
    _save(figure, run / "figures" / "loss.png")

    maneuvers = _read(run / "maneuvers.csv")
    figure, axes = _new_figure("Total reward of each maneuver", "transitions", "return R")
    axes.plot(
        maneuvers["transitions"], maneuvers["return"], ".", ms=1.5, color=_GREY, label="maneuver"
    )
    window = min(RUNNING_MEAN, maneuvers["return"].size)
    if window:
        mean = np.convolve(maneuvers["return"], np.full(window, 1.0 / window), mode="valid")
        label = f"running mean of {window}"
        axes.plot(maneuvers["transitions"][window - 1 :], mean, color=_BLUE, lw=1.2, label=label)
        axes.set_ylim(float(np.quantile(maneuvers["return"], 0.002)) - 0.5, 0.0)
    _mark_optimum(axes, optimal_return)
    _mark_stage(axes, pretraining_transitions)
    axes.legend(loc="lower right")
    _save(figure, run / "figures" / "returns.png")

    models = _read(run / "evaluations.csv")
    figure, axes = _new_figure("Mean return of each saved model", "transitions", "mean return")
    axes.plot(models["transitions"], models["mean_return"], "o-", color=_BLUE, label="saved model")
    _mark_optimum(axes, optimal_return)
    _mark_stage(axes, pretraining_transitions)
    axes.legend(loc="lower right")
    _save(figure, run / "figures" / "saved_models.png")


def draw_maneuver(
    path: Path, first: Maneuver, last: Maneuver, labels: tuple[str, str], scenario: Scenario
) -> None:
    """Yaw acceleration and yaw rate of two models on the same maneuver (Figure 8)."""
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    panels: Any = figure.subplots(1, 2)
    for axes, name, unit in zip(
        panels, ("yaw_acceleration", "yaw_rate"), ("rad/s^2", "rad/s"), strict=True
    ):
        for maneuver, label, color in ((first, labels[0], _RED), (last, labels[1], _BLUE)):
            values = maneuver.trace[name]
            time = np.arange(1, values.size + 1) * scenario.time_step
            axes.plot(time, values, color=color, label=label)
        axes.axhline(0.0, color=_GREY, lw=0.6)
        axes.set_xlabel("time since engagement [s]")
        axes.set_ylabel(f"{name.replace('_', ' ')} [{unit}]")
    panels[0].legend()
    figure.suptitle("The same maneuver under the first and the last saved model")
    _save(figure, path)


def _read(path: Path) -> dict[str, NDArray[np.float64]]:
    """The numeric columns of a table; empty cells are nan."""
    with path.open(newline="", encoding="utf-8") as file:
        header, *rows = list(csv.reader(file))
    return {name: _numbers([row[column] for row in rows]) for column, name in enumerate(header)}


def _numbers(cells: Sequence[str]) -> NDArray[np.float64]:
    def number(cell: str) -> float:
        try:
            return float(cell)
        except ValueError:
            return np.nan

    return np.asarray([number(cell) for cell in cells], np.float64)


def _new_figure(title: str, x_label: str, y_label: str) -> tuple[Figure, Any]:
    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    axes = figure.subplots()
    axes.set_title(title)
    axes.set_xlabel(x_label)
    axes.set_ylabel(y_label)
    return figure, axes


def _mark_stage(axes: Any, pretraining_transitions: int) -> None:
    axes.axvline(pretraining_transitions, color=_GREY, ls=":", lw=1.0)


def _mark_optimum(axes: Any, optimal_return: float | None) -> None:
    if optimal_return is not None:
        axes.axhline(optimal_return, color=_RED, ls="--", lw=1.0, label="optimum")


def _save(figure: Figure, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=120)
