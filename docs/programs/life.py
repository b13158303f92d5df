"""Draw an agent's life: its phases, and a command on seeded traffic that aborts, then completes.

python docs/programs/life.py --figure FILE [--figure FILE ...]
"""

import argparse
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from marl_lanes import load_scenario
from marl_lanes.evaluation.policies import make_tuned_cascade_policy
from marl_lanes.evaluation.recording import record_road
from marl_lanes.evaluation.style import BLUE, GREY, ORANGE, RED, TEAL, WIDTH, styled, write_figure
from marl_lanes.scenario import Scenario
from marl_lanes.traffic.machine.state import Outcome, Phase
from marl_lanes.trajectory.events import find_commands
from marl_lanes.trajectory.frames import Rows

COLOURS = {Phase.WAITING: GREY, Phase.ENGAGED: BLUE, Phase.ABORTING: ORANGE}
STEERS = {Phase.WAITING: "lane keeping", Phase.ENGAGED: "the agent", Phase.ABORTING: "the agent"}
BOX = {"boxstyle": "round,pad=0.5", "facecolor": "white", "linewidth": 1.6}
# Places of the boxes, in the axes' unit square.
PLACES = {Phase.WAITING: (0.22, 0.75), Phase.ENGAGED: (0.58, 0.75), Phase.ABORTING: (0.40, 0.17)}
OUTCOMES = (
    (Outcome.COMPLETED, TEAL, 0.92),
    (Outcome.COLLISION, RED, 0.70),
    (Outcome.OFF_ROAD, RED, 0.53),
    (Outcome.MISSED, GREY, 0.36),
    (Outcome.TIMED_OUT, GREY, 0.19),
    (Outcome.HORIZON, GREY, 0.02),
)

ARROWS = (
    ((0.08, 0.75), (0.115, 0.75), "", (0.0, 0.0)),
    ((0.325, 0.75), (0.49, 0.75), "a safe gap", (0.408, 0.80)),
    ((0.54, 0.64), (0.44, 0.29), "gap unsafe, body\nnot in the lane yet", (0.595, 0.46)),
    ((0.36, 0.29), (0.26, 0.64), "settled in\nits own lane", (0.22, 0.46)),
    ((0.675, 0.79), (0.84, 0.92), "settled in the\ntarget lane", (0.72, 0.96)),
    ((0.79, 0.38), (0.845, 0.70), "from every\nphase", (0.745, 0.36)),
    ((0.795, 0.37), (0.848, 0.53), "", (0.0, 0.0)),
    ((0.80, 0.36), (0.85, 0.36), "", (0.0, 0.0)),
    ((0.795, 0.35), (0.843, 0.19), "", (0.0, 0.0)),
    ((0.79, 0.34), (0.845, 0.02), "", (0.0, 0.0)),
)
"""From where to where, what is said of it, and where."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Find the example and draw it."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--figure", type=Path, action="append", required=True)
    options = parser.parse_args(arguments)
    scenario = load_scenario("adversarial")
    draw(scenario, find_example(scenario), options.figure)


def find_example(scenario: Scenario) -> Rows:
    """The rows of the first command on the roads of seed 0 that aborts once and completes."""
    policy = make_tuned_cascade_policy(scenario)
    for road in range(100):
        rows = record_road(scenario, policy, name="tuned-cascade", road=road).rows
        for command in find_commands(rows):
            if command.outcome == Outcome.COMPLETED and command.num_aborts == 1:
                chosen: Rows = rows[rows["command"] == command.command]
                return chosen
    raise SystemExit("no command of these roads aborts once and completes")


@styled
def draw(scenario: Scenario, rows: Rows, figures: list[Path]) -> None:
    """Write the figure: the phases above, the example below."""
    figure = Figure(figsize=(WIDTH * 1.25, 5.6), layout="constrained")
    above, below = figure.subplots(2, 1, height_ratios=(1.15, 1.0))
    _draw_phases(above)
    _draw_example(below, scenario, rows)
    write_figure(figure, *figures)


def _draw_phases(axes: Axes) -> None:
    axes.set_axis_off()
    axes.set(xlim=(0, 1), ylim=(0, 1), title="An agent's life")
    for phase, (x, y) in PLACES.items():
        text = f"{phase.name.lower()}\nsteers: {STEERS[phase]}"
        axes.text(x, y, text, ha="center", va="center", bbox=BOX | {"edgecolor": COLOURS[phase]})
    axes.text(-0.02, 0.75, "command", ha="left", va="center")
    for outcome, colour, y in OUTCOMES:
        name = outcome.name.lower().replace("_", " ")
        axes.text(0.9, y, name, ha="center", va="center", bbox=BOX | {"edgecolor": colour})
    for begin, end, text, place in ARROWS:
        axes.annotate("", end, begin, arrowprops={"arrowstyle": "->", "linewidth": 1.4})
        axes.text(*place, text, fontsize="small", ha="center", va="center")


def _draw_example(axes: Axes, scenario: Scenario, rows: Rows) -> None:
    time = rows["time"] - rows["time"][0]
    sideways = (rows["lateral_position"] - rows["lateral_position"][0]) * rows["direction"]
    axes.plot(time, sideways, color="black")
    edges = np.flatnonzero(np.diff(rows["phase"])) + 1
    bounds = [0, *edges.tolist(), len(rows) - 1]
    for first, last in pairwise(bounds):
        phase = Phase(rows["phase"][first])
        if phase in COLOURS:
            axes.axvspan(time[first], time[last], color=COLOURS[phase], alpha=0.25, linewidth=0)
            if time[last] - time[first] > 1.0:
                axes.text(time[first] + 0.15, 3.2, phase.name.lower())
    axes.axhline(scenario.road.lane_width, color=TEAL, linestyle="--", linewidth=1.0)
    axes.set(
        ylim=(-0.3, scenario.road.lane_width + 0.4),
        title="One command: an abort, then the change",
        xlabel="time since the command [s]",
        ylabel="to the target lane [m]",
        yticks=(0.0, scenario.road.lane_width),
    )
    axes.margins(x=0.0)


if __name__ == "__main__":
    main()
