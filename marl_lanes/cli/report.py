"""The command that writes the report of a run."""

import argparse
from pathlib import Path

from marl_lanes.cli.arguments import Commands


def add(commands: Commands) -> None:
    """Add ``report``."""
    report = commands.add_parser(
        "report",
        help="write the report of a finished run anew",
        description="Write report.html into the folder of a finished run: its numbers with "
        "intervals, figures, film, failed maneuvers with links into their replays, configuration. "
        "A training writes it at its end; write it anew after you have added replays.",
    )
    report.add_argument("folder", type=Path, metavar="RUN", help="the run folder")
    report.set_defaults(run=_report)


def _report(options: argparse.Namespace) -> None:
    from marl_lanes.report.page import write_report

    print(write_report(options.folder))
