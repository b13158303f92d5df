"""Figures of a run (the paper's Figure 6, Figure 7 and Figure 8) and of the comparisons."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import StrMethodFormatter
from numpy.typing import NDArray

from marl_lanes.colours import LIGHT
from marl_lanes.evaluation.rollout import Maneuver
from marl_lanes.evaluation.style import (
    BLUE,
    FORMATS,
    GREY,
    HEAT,
    LINE_STYLES,
    RED,
    TEAL,
    WIDTH,
    styled,
    write_figure,
)
from marl_lanes.evaluation.tables import choose_decimals, format_estimate
from marl_lanes.scenario import Scenario

RUNNING_MEAN = 200
"""Maneuvers in the running mean of the returns."""

_PANELS: tuple[tuple[str, str, float, int, list[float]], ...] = (
    ("success_rate", "success [%]", 100.0, 1, [90.0, 100.0]),
    ("abort_or_miss_rate", "aborted or missed [%]", 100.0, 1, [0.0, 10.0]),
    ("collision_rate", "collided [%]", 100.0, 1, [0.0, 10.0]),
    ("mean_time_to_completion", "time to complete [s]", 1.0, 2, []),
)
"""Key, title, factor, decimals of a cross-play's panels; values that the colour scale includes."""


@styled
def draw_training(run: Path, pretraining_transitions: int, optimal_return: float | None) -> None:
    """Draw loss, return per maneuver, and mean return and success rates of each saved model.

    Args:
        run: the run folder; its ``figures`` gets each figure in every one of FORMATS.
        pretraining_transitions: end of stage one, 0 if there is one stage.
        optimal_return: mean return of the optimum, drawn as a line; None for no line.
    """
    _draw_loss(run, pretraining_transitions)
    _draw_returns(run, pretraining_transitions, optimal_return)
    _draw_saved_models(run, pretraining_transitions, optimal_return)


def _draw_loss(run: Path, pretraining_transitions: int) -> None:
    metrics = read_table(run / "metrics.csv")
    figure, (axes,) = new_figure("Loss of each batch of updates", 1)
    has_loss = np.isfinite(metrics["loss"])
    axes.plot(metrics["transitions"][has_loss], metrics["loss"][has_loss], color=BLUE, lw=1.0)
    axes.set_yscale("log")
    axes.set_ylabel("mean squared error [1]")
    mark_stage((axes,), pretraining_transitions)
    write_formats(figure, run / "figures" / "loss")


def _draw_returns(run: Path, pretraining_transitions: int, optimal_return: float | None) -> None:
    maneuvers = read_table(run / "maneuvers.csv")
    transitions, returns = maneuvers["transitions"], maneuvers["return"]
    figure, (axes,) = new_figure("Total reward of each maneuver, with noise", 1)
    # Many points are an image also in an SVG: as paths they would make it large and slow.
    axes.plot(
        transitions, returns, ".", ms=1.5, color=GREY, alpha=0.6, label="maneuver", rasterized=True
    )
    window = min(RUNNING_MEAN, returns.size)
    if window:
        mean = np.convolve(returns, np.full(window, 1.0 / window), mode="valid")
        # A single mean would be a line without length.
        look = "-" if mean.size > 1 else "o"
        label = f"running mean of {window}"
        axes.plot(transitions[window - 1 :], mean, look, color=BLUE, label=label)
        axes.set_ylim(float(np.quantile(returns, 0.002)) - 0.5, 0.0)
    axes.set_ylabel("return R [1]")
    _mark_optimum(axes, optimal_return)
    # The legend is below.
    mark_stage((axes,), pretraining_transitions, height=1.0)
    axes.legend(loc="lower right", markerscale=4.0)
    write_formats(figure, run / "figures" / "returns")


def _draw_saved_models(
    run: Path, pretraining_transitions: int, optimal_return: float | None
) -> None:
    models = read_table(run / "evaluations.csv")
    title = "Mean return of each saved model over its completed maneuvers"
    figure, (axes, shares) = new_figure(title, 2, height_ratios=(2, 1))
    axes.plot(models["transitions"], models["mean_return"], "o-", color=BLUE, label="saved model")
    axes.set_ylabel("mean return [1]")
    _mark_optimum(axes, optimal_return)
    axes.legend()
    for key, look, color, label in (
        ("success_rate", "o-", BLUE, "success"),
        ("completion_rate", "x:", RED, "completed"),
    ):
        shares.plot(models["transitions"], 100.0 * models[key], look, color=color, label=label)
    shares.set_ylim(-5.0, 105.0)
    shares.set_ylabel("maneuvers [%]")
    shares.legend()
    mark_stage((axes, shares), pretraining_transitions)
    write_formats(figure, run / "figures" / "saved_models")


@styled
def draw_maneuver(
    stem: Path, title: str, models: Mapping[str, Sequence[Maneuver]], scenario: Scenario
) -> None:
    """Draw yaw acceleration and yaw rate of several models in the same maneuver (Figure 8).

    Args:
        stem: path of the figure without its ending; every one of FORMATS is written.
        title: of the figure.
        models: by each model's name, at most three, its maneuver, once for each training that it
            was saved in.
        scenario: scenario of the maneuver.
    """
    figure, panels = new_figure(title, 2)
    looks = ((RED, LINE_STYLES[1]), (BLUE, LINE_STYLES[0]), (TEAL, LINE_STYLES[2]))
    for axes, name, unit in zip(
        panels, ("yaw_acceleration", "yaw_rate"), ("rad/s²", "rad/s"), strict=True
    ):
        for (label, maneuvers), (color, look) in zip(
            models.items(), looks[: len(models)], strict=True
        ):
            for index, maneuver in enumerate(maneuvers):
                values = maneuver.trace[name]
                time = np.arange(1, values.size + 1) * scenario.time_step
                axes.plot(time, values, look, color=color, label=label if index == 0 else None)
        axes.axhline(0.0, color=GREY, ls="-", lw=0.6)
        axes.set_ylabel(f"{name.replace('_', ' ')} [{unit}]")
    panels[0].legend()
    panels[1].set_xlabel("time since engagement [s]")
    write_formats(figure, stem)


def check_figure(path: Path) -> None:
    """Raise ValueError for a path to which no figure can be written."""
    formats = sorted(Figure().canvas.get_supported_filetypes())
    if path.is_dir() or path.suffix[1:].lower() not in formats:
        raise ValueError(f"figure {path}: must be a file that ends in one of {', '.join(formats)}")


@styled
def draw_crossplay(paths: Sequence[Path], result: Mapping[str, Any]) -> None:
    """Draw heat maps, changers by followers, with value and interval in every cell.

    Args:
        paths: where the figure is written, in the format of each ending.
        result: of ``crossplay``.
    """
    changers, followers = list(result["changers"]), list(result["followers"])
    pairs = {(pair["changer"], pair["followers"]): pair["statistics"] for pair in result["pairs"]}
    width, height = 2.2 + 1.5 * len(followers), 1.6 + 0.8 * len(changers)
    figure = Figure(figsize=(2.0 * width, 2.0 * height), layout="constrained")
    panels: Any = figure.subplots(2, 2)
    for axes, (key, title, factor, places, span) in zip(panels.flat, _PANELS, strict=True):
        decimals = choose_decimals(places, factor, result["num_maneuvers"])
        table = [[pairs[changer, label][key] for label in followers] for changer in changers]
        values = factor * np.asarray([[cell["value"] for cell in row] for row in table], np.float64)
        ends = [*values[np.isfinite(values)].tolist(), *span] or [0.0]
        image = axes.imshow(values, cmap=HEAT, vmin=min(ends), vmax=max(ends), aspect="auto")
        axes.grid(visible=False)
        figure.colorbar(image, ax=axes)
        for row, column in np.ndindex(values.shape):
            text = format_estimate(table[row][column], factor, decimals).replace(" [", "\n[")
            axes.text(column, row, text, ha="center", va="center")
        axes.set_title(title)
        axes.set_xticks(range(len(followers)), followers, rotation=20.0, ha="right")
        axes.set_yticks(range(len(changers)), changers)
        axes.set_xlabel("followers")
        axes.set_ylabel("changer")
    figure.suptitle(
        f"{result['num_maneuvers']} maneuvers per cell, "
        f"{100.0 * result['confidence']:g} % intervals"
    )
    write_figure(figure, *paths)


@styled
def draw_gaps(paths: Sequence[Path], result: Mapping[str, Any]) -> None:
    """Draw the gap and the follower's acceleration in one maneuver with every kind of follower.

    Args:
        paths: where the figure is written, in the format of each ending.
        result: of ``compare_followers``.
    """
    title = f"Maneuver {result['maneuver']} of seed {result['seed']} on {result['scenario']}"
    figure, panels = new_figure(title, 2)
    for label, found in result["followers"].items():
        shown = found["shown"]
        time = np.asarray(shown["time"])
        for axes, name in zip(panels, ("gap", "follower_acceleration"), strict=True):
            values = np.asarray(shown[name], np.float64)
            (line,) = axes.plot(time, values, label=label)
            for moment, mark in (("entry_time", "o"), ("abort_time", "x")):
                if shown[moment] is not None:
                    at = [int(np.abs(time - shown[moment]).argmin())]
                    axes.plot(time[at], values[at], mark, color=line.get_color(), ms=8.0, mew=2.0)
    panels[0].set_ylabel("gap to the follower [m]")
    panels[0].legend(title="o: in the lane, x: aborts")
    panels[1].axhline(0.0, color=GREY, ls="-", lw=0.6)
    panels[1].set_ylabel("follower's acceleration [m/s²]")
    panels[1].set_xlabel("time since engagement [s]")
    write_figure(figure, *paths)


def read_table(path: Path) -> dict[str, NDArray[np.float64]]:
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


def new_figure(title: str, num_panels: int, **options: Any) -> tuple[Figure, Any]:
    """A figure with panels above one another, which share the axis of x, and its panels.

    Args:
        title: of the first panel.
        num_panels: number of panels.
        **options: of ``Figure.subplots``.

    Returns:
        the figure, and its axes. The axis of x counts transitions unless it gets another label.
    """
    height = WIDTH * (0.35 + 0.3 * num_panels)
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    panels = figure.subplots(num_panels, 1, sharex=True, squeeze=False, **options)[:, 0]
    panels[0].set_title(title)
    panels[-1].set_xlabel("transitions [1]")
    panels[-1].xaxis.set_major_formatter(StrMethodFormatter("{x:,.10g}"))
    return figure, panels


def mark_stage(panels: Sequence[Any], pretraining_transitions: int, height: float = 0.0) -> None:
    """A dotted line at the end of stage one, with its name in the first panel, at that height.

    Args:
        panels: axes whose x counts transitions.
        pretraining_transitions: end of stage one, 0 for no line.
        height: of the name, as a share of the panel's.
    """
    if not pretraining_transitions:
        return
    for axes in panels:
        axes.axvline(pretraining_transitions, color=GREY, ls=":", lw=1.2)
    panels[0].annotate(
        "end of stage one",
        (pretraining_transitions, height),
        xycoords=("data", "axes fraction"),
        xytext=(4.0, 4.0 - 16.0 * height),
        textcoords="offset points",
        fontsize="small",
        bbox={"facecolor": LIGHT.background, "edgecolor": "none", "pad": 1.0},
    )


def _mark_optimum(axes: Any, optimal_return: float | None) -> None:
    if optimal_return is not None:
        axes.axhline(optimal_return, color=RED, ls="--", label="optimum")


def write_formats(figure: Figure, stem: Path) -> None:
    """Write the figure in every one of FORMATS, to this path with an ending."""
    write_figure(figure, *(stem.with_name(f"{stem.name}.{kind}") for kind in FORMATS))
