"""Figures of a run (the paper's Figure 6, Figure 7 and Figure 8) and of the comparisons."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from marl_lanes.evaluation.rollout import Maneuver
from marl_lanes.evaluation.tables import format_estimate
from marl_lanes.files import write_atomically
from marl_lanes.scenario import Scenario

RUNNING_MEAN = 200
"""Maneuvers in the running mean of the returns."""

_BLUE, _RED, _GREY = "#1f5fa8", "#c23b22", "#9aa0a6"

_PANELS: tuple[tuple[str, str, float, int, list[float]], ...] = (
    ("success_rate", "success [%]", 100.0, 1, [90.0, 100.0]),
    ("abort_or_miss_rate", "aborted or missed [%]", 100.0, 1, [0.0, 10.0]),
    ("collision_rate", "collided [%]", 100.0, 1, [0.0, 10.0]),
    ("mean_time_to_completion", "time to complete [s]", 1.0, 2, []),
)
"""Key, title, factor, decimals of a cross-play's panels; values that the colour scale includes."""


def draw_training(run: Path, pretraining_transitions: int, optimal_return: float | None) -> None:
    """Draw loss, return per maneuver, and mean return and success rates of each saved model.

    Args:
        run: the run folder; the figures are written to its ``figures``.
        pretraining_transitions: end of stage one, 0 if there is one stage.
        optimal_return: mean return of the optimum, drawn as a line; None for no line.
    """
    metrics = _read(run / "metrics.csv")
    figure, axes = _new_figure("Loss", "transitions", "mean squared error")
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
    figure = Figure(figsize=(6.4, 6.0), layout="constrained")
    axes, shares = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    axes.set_title("Mean return of each saved model over its completed maneuvers")
    axes.set_ylabel("mean return")
    axes.plot(models["transitions"], models["mean_return"], "o-", color=_BLUE, label="saved model")
    _mark_optimum(axes, optimal_return)
    axes.legend(loc="lower right")
    for key, style, label in (
        ("success_rate", "o-", "success"),
        ("completion_rate", "x:", "completed"),
    ):
        shares.plot(models["transitions"], 100.0 * models[key], style, color=_BLUE, label=label)
    shares.set_ylim(-5.0, 105.0)
    shares.set_xlabel("transitions")
    shares.set_ylabel("maneuvers [%]")
    shares.legend(loc="lower right")
    for panel in (axes, shares):
        _mark_stage(panel, pretraining_transitions)
    _save(figure, run / "figures" / "saved_models.png")


def draw_maneuver(
    path: Path, first: Maneuver, last: Maneuver, labels: tuple[str, str], scenario: Scenario
) -> None:
    """Draw yaw acceleration and yaw rate of two models in the same maneuver (Figure 8)."""
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
    figure.suptitle("The same maneuver with the first and the last saved model")
    _save(figure, path)


def check_figure(path: Path) -> None:
    """Raise ValueError for a path to which no figure can be written."""
    formats = sorted(Figure().canvas.get_supported_filetypes())
    if path.is_dir() or path.suffix[1:].lower() not in formats:
        raise ValueError(f"figure {path}: must be a file that ends in one of {', '.join(formats)}")


def draw_crossplay(path: Path, result: Mapping[str, Any]) -> None:
    """Draw heat maps, changers by followers, with value and interval in every cell.

    Args:
        path: of the figure.
        result: of ``crossplay``.
    """
    changers, followers = list(result["changers"]), list(result["followers"])
    pairs = {(pair["changer"], pair["followers"]): pair["statistics"] for pair in result["pairs"]}
    width, height = 2.2 + 1.5 * len(followers), 1.6 + 0.8 * len(changers)
    figure = Figure(figsize=(2.0 * width, 2.0 * height), layout="constrained")
    panels: Any = figure.subplots(2, 2)
    for axes, (key, title, factor, decimals, span) in zip(panels.flat, _PANELS, strict=True):
        table = [[pairs[changer, label][key] for label in followers] for changer in changers]
        values = factor * np.asarray([[cell["value"] for cell in row] for row in table], np.float64)
        ends = [*values[np.isfinite(values)].tolist(), *span] or [0.0]
        image = axes.imshow(
            values, cmap="Blues", vmin=min(ends), vmax=max(ends), alpha=0.6, aspect="auto"
        )
        figure.colorbar(image, ax=axes)
        for row, column in np.ndindex(values.shape):
            text = format_estimate(table[row][column], factor, decimals).replace(" [", "\n[")
            axes.text(column, row, text, ha="center", va="center")
        axes.set_title(title)
        axes.set_xticks(range(len(followers)), followers, rotation=20.0, ha="right")
        axes.set_yticks(range(len(changers)), changers)
    figure.suptitle(
        f"{result['num_maneuvers']} maneuvers per cell, "
        f"{100.0 * result['confidence']:g} % intervals"
    )
    _save(figure, path)


def draw_gaps(path: Path, result: Mapping[str, Any]) -> None:
    """Draw the gap and the follower's acceleration in one maneuver with every kind of follower.

    Args:
        path: of the figure.
        result: of ``compare_followers``.
    """
    figure = Figure(figsize=(7.2, 6.0), layout="constrained")
    panels: Any = figure.subplots(2, 1, sharex=True)
    for label, found in result["followers"].items():
        shown = found["shown"]
        time = np.asarray(shown["time"])
        for axes, name in zip(panels, ("gap", "follower_acceleration"), strict=True):
            values = np.asarray(shown[name], np.float64)
            (line,) = axes.plot(time, values, label=label)
            for moment, mark in (("entry_time", "o"), ("abort_time", "x")):
                if shown[moment] is not None:
                    at = [int(np.abs(time - shown[moment]).argmin())]
                    axes.plot(time[at], values[at], mark, color=line.get_color(), ms=8.0)
    panels[0].set_ylabel("gap to the follower [m]")
    panels[0].legend(title="o: in the lane, x: aborts")
    panels[1].axhline(0.0, color=_GREY, lw=0.6)
    panels[1].set_ylabel("follower's acceleration [m/s^2]")
    panels[1].set_xlabel("time since engagement [s]")
    figure.suptitle(
        f"Maneuver {result['maneuver']} of seed {result['seed']} on {result['scenario']}"
    )
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
    if pretraining_transitions:
        axes.axvline(pretraining_transitions, color=_GREY, ls=":", lw=1.0)


def _mark_optimum(axes: Any, optimal_return: float | None) -> None:
    if optimal_return is not None:
        axes.axhline(optimal_return, color=_RED, ls="--", lw=1.0, label="optimum")


def _save(figure: Figure, path: Path) -> None:
    """Write the figure completely or not at all."""
    kind = path.suffix[1:]
    write_atomically(path, lambda temporary: figure.savefig(temporary, dpi=120, format=kind))
