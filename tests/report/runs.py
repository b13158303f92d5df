"""A finished run's folder made by hand, for tests."""

import csv
import json

from marl_lanes.evaluation.headlines import HEADLINES
from marl_lanes.evaluation.maneuver_table import Row
from marl_lanes.report.page import FIGURES

SVG = """<?xml version="1.0" encoding="utf-8"?>
<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"
 width="460pt" height="280pt" viewBox="0 0 460 280" version="1.1">
 <defs><clipPath id="p1"><rect x="0" y="0" width="9" height="9"/></clipPath></defs>
 <g id="line_1"><path d="M 0 0 L 9 9" clip-path="url(#p1)" style="fill: none; stroke: #2748e8"/></g>
 <text style="fill: #1b1f24" x="3" y="4">return R [1]</text>
 <use xlink:href="#line_1" x="1" y="2"/>
</svg>
"""


def row(road, command, outcome="completed", failure="", **changes):
    """A maneuver; a success unless it has a failure."""
    values = {
        "road": road,
        "command": command,
        "vehicle": 100 + command,
        "outcome": outcome,
        "is_success": int(not failure),
        "failure": failure,
        "command_time": 10.5,
        "end_time": 21.25,
        "failure_time": 23.5 if failure else "",
        "num_aborts": 0,
    }
    return dict.fromkeys((name.removesuffix("_") for name in Row._fields), "") | values | changes


ROWS = (
    row(0, 0),
    row(0, 1, "missed", "reached the end of the road while waiting for a gap"),
    row(1, 0, "completed", "lost 2.3 s after completion", num_aborts=3),
    row(1, 1),
)


def intervals():
    """Of each headline: 0.5 and up, so that every number on the page is another."""
    return {
        headline.key: {"value": place, "low": place - 0.0625, "high": place + 0.0625}
        for headline, place in ((one, 0.5 + 0.03125 * index) for index, one in enumerate(HEADLINES))
    }


def make_run(folder, rows=ROWS, choice=None, **changes):
    """Write the folder; ``changes`` are fields of evaluation.json."""
    evaluation = {
        "scenario": "paper",
        "policy": "checkpoints/final.pt",
        "seed": 1000000,
        "num_maneuvers": len(rows),
        "no_cost_ratio": None,
        "confidence": 0.95,
        "intervals": intervals(),
        "versions": {"numpy": "2.4.6", "python": "3.11.7"},
    } | changes
    (folder / "figures").mkdir(parents=True)
    for name in FIGURES:
        for kind in ("svg", "png"):
            (folder / "figures" / f"{name}.{kind}").write_text(SVG, encoding="utf-8")
    (folder / "evaluation.json").write_text(json.dumps(evaluation), encoding="utf-8")
    (folder / "config.yaml").write_text("scenario: paper\nseed: 0\n", encoding="utf-8")
    (folder / "scenario.yaml").write_text("name: paper\n", encoding="utf-8")
    (folder / "command.txt").write_text("python train.py seed=0\n", encoding="utf-8")
    seconds = {"seconds_training": 1156.25, "seconds_evaluating": 9.5}
    (folder / "training.json").write_text(json.dumps(seconds), encoding="utf-8")
    if choice is not None:
        (folder / "choice.json").write_text(json.dumps({"chosen": choice}), encoding="utf-8")
    with (folder / "final_maneuvers.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, ROWS[0])
        writer.writeheader()
        writer.writerows(rows)
    return folder


def add_replays(run, *roads):
    (run / "replays").mkdir()
    for road in roads:
        (run / "replays" / f"road_{road:04d}.html").write_text("<p>", encoding="utf-8")
