"""The figure of a league's ratings."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from marl_lanes.evaluation.style import BLUE, RED, WIDTH, styled, write_figure

_LOOKS = {"changer": (BLUE, "-", "o"), "followers": (RED, "--", "s")}
"""Colour, line and mark by role."""


@styled
def draw_ratings(paths: Sequence[Path], leagues: Sequence[Mapping[str, Any]]) -> None:
    """Draw ratings over generations, and beside them those of all players that have none.

    Args:
        paths: where the figure is written, in the format of each ending.
        leagues: each with ``confidence``, ``num_maneuvers`` and ``ratings``: of each player the
            fields of ``Rating``, with ``generation``, None for a named one, and ``is_held_out``.
            With several, each has lines of its own.
    """
    figure = Figure(figsize=(1.5 * WIDTH, 0.7 * WIDTH), layout="constrained")
    learned, named = figure.subplots(1, 2, sharey=True, width_ratios=(3, 2))
    names: list[str] = []
    offsets = [0.08 * (number - 0.5 * (len(leagues) - 1)) for number in range(len(leagues))]
    for number, league in enumerate(leagues):
        for role, (color, line, mark) in _LOOKS.items():
            rows = [one for one in league["ratings"] if one["role"] == role]
            trained = [one for one in rows if one["generation"] is not None]
            generations = [one["generation"] + offsets[number] for one in trained]
            label = None if number else role
            _draw(learned, generations, trained, color=color, ls=line, marker=mark, label=label)
            known = [one for one in rows if one["generation"] is None]
            names += [one["player"] for one in known if one["player"] not in names]
            # Those that nobody has learned against are hollow.
            for one in known:
                face = "none" if one["is_held_out"] else color
                place = [names.index(one["player"]) + offsets[number]]
                _draw(named, place, [one], color=color, ls="", marker=mark, mfc=face)
    learned.set_title("Learned, by generation")
    learned.set_xlabel("generation [1]")
    learned.set_ylabel("rating [points]")
    learned.xaxis.set_major_locator(MaxNLocator(integer=True))
    learned.legend()
    named.set_title("Others; hollow: never learned against")
    named.set_xticks(range(len(names)), names, rotation=35.0, ha="right")
    named.set_xlim(-0.5, len(names) - 0.5)
    first = leagues[0]
    figure.suptitle(
        f"{first['num_maneuvers']} maneuvers per match, {100.0 * first['confidence']:g} % "
        "intervals; 400 points are odds of 10 to 1"
    )
    write_figure(figure, *paths)


def _draw(
    axes: Any, places: Sequence[float], rows: Sequence[Mapping[str, Any]], **look: Any
) -> None:
    """Ratings at the places, with their intervals where they have one."""
    values = [one["rating"] for one in rows]
    ends = [(one["rating"], one["low"], one["high"]) for one in rows]
    lengths = [(0.0, 0.0) if low is None else (at - low, high - at) for at, low, high in ends]
    axes.errorbar(places, values, list(zip(*lengths, strict=True)), capsize=3.0, **look)
