"""The style of all figures, and their files: the same data, the same bytes."""

from pathlib import Path
from typing import Any

from cycler import cycler
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.style import context

from marl_lanes.colours import LIGHT
from marl_lanes.files import write_atomically

BLUE, RED, TEAL, PLUM, ORANGE, GREY = LIGHT.series

LINE_STYLES = ("-", "--", "-.", ":")
"""The n-th series has the n-th of these, beside its colour."""

FORMATS = ("svg", "png")
"""A figure of a run or of the documentation is written as each of these."""

WIDTH = 6.4
"""[inch] Of a figure with one panel."""

_NUM_LOOKS = 20
"""Series until colour and line style are both as before."""

_COLOURS = LIGHT.series[:-1]

HEAT = LinearSegmentedColormap.from_list("heat", [LIGHT.background, "#8fa3f6"])
"""Colours of a heat map, light enough for text upon them."""

STYLE: dict[str, Any] = {
    "axes.axisbelow": True,
    "axes.edgecolor": LIGHT.text,
    "axes.grid": True,
    "axes.labelcolor": LIGHT.text,
    "axes.prop_cycle": cycler(
        color=[_COLOURS[index % len(_COLOURS)] for index in range(_NUM_LOOKS)],
        linestyle=[LINE_STYLES[index % len(LINE_STYLES)] for index in range(_NUM_LOOKS)],
    ),
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titlesize": "medium",
    "axes.titleweight": "bold",
    "figure.facecolor": LIGHT.background,
    "figure.titlesize": "medium",
    "figure.titleweight": "bold",
    "font.family": "sans-serif",
    # The first comes with matplotlib; the second has its widths.
    "font.sans-serif": ["DejaVu Sans", "Verdana", "sans-serif"],
    "font.size": 10.0,
    "grid.color": LIGHT.grid,
    "grid.linewidth": 0.6,
    "legend.fontsize": "small",
    "legend.framealpha": 0.9,
    "legend.edgecolor": LIGHT.grid,
    "legend.title_fontsize": "small",
    "lines.linewidth": 1.6,
    "lines.markersize": 5.0,
    "savefig.dpi": 120.0,
    # Text stays text: it can be searched, read aloud, and shown in another colour.
    "svg.fonttype": "none",
    # Names of parts come from their content alone.
    "svg.hashsalt": "marl-lanes",
    "text.color": LIGHT.text,
    "xtick.color": LIGHT.text,
    "ytick.color": LIGHT.text,
}
"""matplotlib's settings while a figure is made and written."""

_METADATA: dict[str, dict[str, None]] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
"""By format: what would differ from one second to the next."""


styled = context(STYLE, after_reset=True)
"""Decorator: a function draws and writes in STYLE, whatever the user's own settings are."""


def write_figure(figure: Figure, *paths: Path) -> None:
    """Write the figure, each file completely or not at all, in the format that its ending names."""
    for path in paths:
        kind = path.suffix[1:].lower()

        def write(temporary: Path, kind: str = kind) -> None:
            figure.savefig(temporary, format=kind, metadata=_METADATA.get(kind))

        write_atomically(path, write)
