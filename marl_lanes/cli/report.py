"""The command that writes the report of a run."""

import argparse

from marl_lanes.cli.arguments import Commands
from marl_lanes.cli.values import file_name
from marl_lanes.terminal import say


def add(commands: Commands) -> None:
    """Add ``report``."""
    report = commands.add_parser(
        "report",
        help="write the report of a finished run anew",
        description="Write report.html into the folder of a finished run: its numbers with "
        "intervals, figures, film, failed maneuvers with links into their replays, configuration. "
        "A training writes it at its end; write it anew after you have added replays.",
    )
    report.add_argument("folder", type=file_name, metavar="RUN", help="the run folder")
    report.set_defaults(run=_report)


def _report(options: argparse.Namespace) -> None:
    from marl_lanes.report.page import write_report

    say(str(write_report(options.folder)))
