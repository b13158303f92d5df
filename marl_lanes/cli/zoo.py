"""The command that shows the trained policies that ship with the package."""

import argparse

from marl_lanes.cli import completers
from marl_lanes.cli.arguments import Commands, add_command, add_json
from marl_lanes.cli.completers import offer
from marl_lanes.cli.outputs import check_outputs, show_result
from marl_lanes.evaluation.tables import (
    PER_CENT,
    choose_decimals,
    format_estimate,
    format_table,
)
from marl_lanes.zoo.index import PREFIX, ZooError, find_entry, read_index


def add(commands: Commands) -> None:
    """Add ``zoo``."""
    zoo = add_command(
        commands,
        "zoo",
        _show,
        summary="list the trained policies that ship, or show one",
        description="List the trained policies that ship with the package, or print all that is "
        f"known of one. {PREFIX}NAME stands for its checkpoint in every command, program and "
        "scenario.",
        examples="""
            marl-lanes zoo
            marl-lanes zoo paper
            marl-lanes zoo --json -
        """,
    )
    offer(
        zoo.add_argument("name", nargs="?", help=f"of a policy, with or without {PREFIX}"),
        completers.zoo,
    )
    add_json(zoo)


def _show(options: argparse.Namespace) -> None:
    check_outputs([("--json", options.json)], [])
    if options.name is None:
        show_result(options.json, read_index(), _list())
        return
    try:
        entry = find_entry(options.name)
    except ZooError as error:
        raise ValueError(f"zoo {options.name}: {error}") from None
    from marl_lanes.scenario.yaml_files import format_yaml

    show_result(options.json, entry, format_yaml(dict(entry)).rstrip("\n"))


def _list() -> str:
    """Each policy with its main measurement."""
    lines = []
    for name, entry in read_index().items():
        row = entry["rows"][0]
        success, ratio = (row["statistics"][key] for key in ("success_rate", "cost_ratio"))
        decimals = choose_decimals(1, PER_CENT, row["num_maneuvers"])
        cells = [format_estimate(success, PER_CENT, decimals), format_estimate(ratio, decimals=3)]
        lines.append([PREFIX + name, entry["role"], *cells, row["policy"], row["task"]])
    head = ["name", "role", "success [%]", "cost ratio", "measured: changer", "task"]
    return format_table(head, lines, 1)
