"""Figures of trainings that differ by their seed alone: the median, in a band from low to high.

The paper's Figures 6 and 7, of several scenarios in one figure. Of three seeds the band is their
range; no model of how seeds vary is in it.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from marl_lanes.evaluation.figures import mark_stage, new_figure, read_table, write_formats
from marl_lanes.evaluation.style import BLUE, GREY, RED, TEAL, styled
from marl_lanes.traffic.machine.state import Outcome

NUM_BINS = 80
"""Parts of a training in each of which values are averaged."""

_LOOKS = ((BLUE, "-"), (RED, "--"), (TEAL, "-."))
"""Colour and line style by scenario."""

Runs = Mapping[str, Sequence[Path]]
"""The run folders of every seed, by scenario."""
FloatArray = NDArray[np.float64]


@styled
def draw_losses(stem: Path, runs: Runs, pretraining_transitions: int) -> None:
    """Draw the loss over transitions (Figure 6a).

    Args:
        stem: path of the figure without its ending; every one of FORMATS is written.
        runs: the trainings.
        pretraining_transitions: end of stage one.
    """
    figure, (axes,) = new_figure("Loss, in the median and the range of the seeds", 1)
    for (scenario, folders), look in zip(runs.items(), _LOOKS, strict=False):
        tables = [read_table(folder / "metrics.csv") for folder in folders]
        edges = _edges(tables)
        rows = [_average(edges, table["transitions"], table["loss"]) for table in tables]
        _draw_band(axes, _centres(edges), rows, look, scenario)
    axes.set_yscale("log")
    axes.set_ylabel("mean squared error [1]")
    axes.legend()
    mark_stage((axes,), pretraining_transitions)
    write_formats(figure, stem)


@styled
def draw_returns(stem: Path, runs: Runs, pretraining_transitions: int) -> None:
    """Draw the return of each completed maneuver, and which share is completed (Figure 6b).

    Args:
        stem: as for ``draw_losses``.
        runs: the trainings.
        pretraining_transitions: end of stage one.
    """
    title = "Total reward of completed maneuvers, with noise"
    figure, (axes, shares) = new_figure(title, 2, height_ratios=(2, 1))
    for (scenario, folders), look in zip(runs.items(), _LOOKS, strict=False):
        tables = [read_table(folder / "maneuvers.csv") for folder in folders]
        edges = _edges(tables)
        returns, completed = [], []
        lowest: list[float] = []
        for table in tables:
            is_completed = table["outcome"] == Outcome.COMPLETED
            at, value = table["transitions"][is_completed], table["return"][is_completed]
            axes.plot(at, value, ".", ms=1.0, color=GREY, alpha=0.3, rasterized=True)
            lowest.extend(np.quantile(value, [0.002]) if value.size else [])
            returns.append(_average(edges, at, value))
            completed.append(_average(edges, table["transitions"], 100.0 * is_completed))
        if lowest:
            axes.set_ylim(min(lowest) - 0.5, 0.0)
        _draw_band(axes, _centres(edges), returns, look, scenario)
        _draw_band(shares, _centres(edges), completed, look, scenario)
    axes.set_ylabel("return R [1]")
    axes.legend()
    shares.set_ylim(-5.0, 105.0)
    shares.set_ylabel("completed [%]")
    mark_stage((axes, shares), pretraining_transitions)
    write_formats(figure, stem)


@styled
def draw_models(stem: Path, runs: Runs, pretraining_transitions: int) -> None:
    """Draw each saved model's mean return over completed maneuvers, and success (Figure 7).

    Args:
        stem: as for ``draw_losses``.
        runs: the trainings; of a scenario's, as many models are drawn as each has saved.
        pretraining_transitions: end of stage one.
    """
    title = "Mean return of each saved model over its completed maneuvers"
    figure, (axes, shares) = new_figure(title, 2, height_ratios=(2, 1))
    for (scenario, folders), look in zip(runs.items(), _LOOKS, strict=False):
        tables = [read_table(folder / "evaluations.csv") for folder in folders]
        number = min(table["transitions"].size for table in tables)
        at = np.mean([table["transitions"][:number] for table in tables], axis=0)
        for panel, key, factor in ((axes, "mean_return", 1.0), (shares, "success_rate", 100.0)):
            rows = [factor * table[key][:number] for table in tables]
            _draw_band(panel, at, rows, look, scenario, marker="o")
    axes.set_ylabel("mean return [1]")
    axes.legend()
    shares.set_ylim(-5.0, 105.0)
    shares.set_ylabel("success [%]")
    mark_stage((axes, shares), pretraining_transitions)
    write_formats(figure, stem)


def _draw_band(
    axes: Any,
    at: FloatArray,
    rows: Sequence[FloatArray],
    look: tuple[str, str],
    label: str,
    **options: Any,
) -> None:
    """A line through the medians where every seed has a value, in the seeds' range."""
    values = np.asarray(rows)
    is_known = np.isfinite(values).all(axis=0)
    values, at = values[:, is_known], at[is_known]
    color, style = look
    name = label if at.size else f"{label}: none"
    axes.plot(at, np.median(values, axis=0), style, color=color, label=name, **options)
    axes.fill_between(at, values.min(axis=0), values.max(axis=0), color=color, alpha=0.2, lw=0.0)


def _edges(tables: Sequence[Mapping[str, FloatArray]]) -> FloatArray:
    """The parts of the trainings, in transitions."""
    last = max(table["transitions"].max(initial=1.0) for table in tables)
    return np.linspace(0.0, last, NUM_BINS + 1)


def _centres(edges: FloatArray) -> FloatArray:
    return 0.5 * (edges[:-1] + edges[1:])


def _average(edges: FloatArray, at: FloatArray, values: FloatArray) -> FloatArray:
    """Mean of the finite values in each part; nan in a part without one."""
    is_finite = np.isfinite(values)
    sums, _ = np.histogram(at[is_finite], edges, weights=values[is_finite])
    counts, _ = np.histogram(at[is_finite], edges)
    means: FloatArray = np.divide(sums, counts, out=np.full(sums.size, np.nan), where=counts > 0)
    return means
