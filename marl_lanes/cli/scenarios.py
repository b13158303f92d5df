"""The command that shows scenarios."""

import argparse

from marl_lanes.cli.arguments import Commands
from marl_lanes.scenario import list_scenarios, load_scenario
from marl_lanes.scenario.yaml_files import format_yaml
from marl_lanes.terminal import say


def add(commands: Commands) -> None:
    """Add ``scenarios``."""
    scenarios = commands.add_parser(
        "scenarios", help="list the shipped scenarios, or print one in full"
    )
    scenarios.add_argument("scenario", nargs="?", help="a shipped name or the path of a YAML file")
    scenarios.set_defaults(run=_show_scenarios)


def _show_scenarios(options: argparse.Namespace) -> None:
    if options.scenario is not None:
        scenario = load_scenario(options.scenario)
        say(format_yaml(scenario.model_dump(mode="json")).rstrip("\n"))
        return
    lines = [f"{name:12} {load_scenario(name).description}" for name in list_scenarios()]
    say("\n".join(lines))
