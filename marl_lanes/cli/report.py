"""The command that writes the report of a run."""

import argparse

from marl_lanes.cli.arguments import Commands, add_command
from marl_lanes.cli.values import file_name
from marl_lanes.terminal import say


def add(commands: Commands) -> None:
    """Add ``report``."""
    report = add_command(
        commands,
        "report",
        _report,
        summary="write the report of a finished run anew",
        description="Write report.html into the folder of a finished run: its numbers with "
        "intervals, figures, film, failed maneuvers with links into their replays, configuration. "
        "A training writes it at its end; write it anew after you have added replays.",
        examples="""
            marl-lanes report runs/paper
        """,
    )
    report.add_argument("folder", type=file_name, metavar="RUN", help="the run folder")


def _report(options: argparse.Namespace) -> None:
    from marl_lanes.report.page import write_report

    say(str(write_report(options.folder)))
