"""Draw the curves of docs/examples: the return and the completed share against the training.

python docs/programs/curves.py FILE.csv ... --figure FILE [--figure FILE ...]
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, PercentFormatter, StrMethodFormatter

from marl_lanes.evaluation.style import WIDTH, styled, write_figure


def main(arguments: Sequence[str] | None = None) -> None:
    """Read the files and draw them; a file's name is its label."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("curves", type=Path, nargs="+", metavar="FILE.csv")
    parser.add_argument("--figure", type=Path, action="append", required=True)
    options = parser.parse_args(arguments)
    draw(options.curves, options.figure)


@styled
def draw(curves: Sequence[Path], figures: Sequence[Path]) -> None:
    """Write the figure: the success beside the return, for neither says enough alone."""
    figure = Figure(figsize=(WIDTH * 1.5, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2, sharex=True)
    for path in curves:
        steps, returns, shares = np.loadtxt(path, delimiter=",", skiprows=1, unpack=True)
        left.plot(steps, returns, label=path.stem)
        right.plot(steps, shares, label=path.stem)
    left.set(xlabel="steps of a road", ylabel="mean return of a command")
    right.set(xlabel="steps of a road", ylabel="commands completed", ylim=(-0.03, 1.03))
    left.xaxis.set_major_locator(MaxNLocator(4))
    left.xaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
    right.yaxis.set_major_formatter(PercentFormatter(1.0))
    figure.legend(*left.get_legend_handles_labels(), loc="outside right center")
    write_figure(figure, *figures)


if __name__ == "__main__":
    main()
