"""The commands on scenarios: list them, show one in full, check files, print their JSON Schema."""

import argparse
import json

from marl_lanes.cli import completers
from marl_lanes.cli.arguments import Commands, add_command, add_json
from marl_lanes.cli.completers import offer
from marl_lanes.cli.outputs import check_outputs, show_result
from marl_lanes.plugins import add_import, import_modules
from marl_lanes.terminal import say

_KIND = "a shipped name or the path of a YAML file"


def add(commands: Commands) -> None:
    """Add ``scenarios``, ``show``, ``validate`` and ``schema``."""
    _add_list(commands)
    _add_show(commands)
    _add_validate(commands)
    add_command(
        commands,
        "schema",
        _print_schema,
        summary="print the JSON Schema of scenarios, for editors",
        description="Print the JSON Schema of a scenario's file. An editor that knows it completes "
        "and explains the fields; docs/scenarios.md says how.",
        examples="""
            marl-lanes schema > scenario.schema.json
        """,
    )


def _add_list(commands: Commands) -> None:
    scenarios = add_command(
        commands,
        "scenarios",
        _list_scenarios,
        summary="list the shipped scenarios",
        description="List the shipped scenarios, each with its purpose.",
        examples="""
            marl-lanes scenarios
            marl-lanes scenarios --json -
        """,
    )
    add_json(scenarios)


def _add_show(commands: Commands) -> None:
    show = add_command(
        commands,
        "show",
        _show_scenario,
        summary="print all fields of a scenario",
        description="Print all fields of a scenario as YAML, also those that its file leaves out. "
        "What it prints is a scenario's file.",
        examples="""
            marl-lanes show dense
            marl-lanes show rush.yaml --json rush.json
        """,
    )
    offer(show.add_argument("scenario", metavar="SCENARIO", help=_KIND), completers.scenarios)
    add_json(show)


def _add_validate(commands: Commands) -> None:
    validate = add_command(
        commands,
        "validate",
        _validate,
        summary="check files of scenarios",
        description="Check scenarios: fields, limits, what fields must satisfy together, and "
        "whether each follower of the mix has a policy. The status is 0 if all are valid and 1 if "
        "one is not: then it is said what is wrong.",
        examples="""
            marl-lanes validate rush.yaml
            marl-lanes validate *.yaml --import mine --json -
        """,
    )
    argument = validate.add_argument("scenarios", nargs="+", metavar="SCENARIO", help=_KIND)
    offer(argument, completers.scenarios)
    add_import(validate)
    add_json(validate)


def _list_scenarios(options: argparse.Namespace) -> None:
    from marl_lanes.scenario import list_scenarios, load_scenario

    check_outputs([("--json", options.json)], [])
    purposes = {name: load_scenario(name).description for name in list_scenarios()}
    result = [{"name": name, "description": purpose} for name, purpose in purposes.items()]
    lines = [f"{name:12} {purpose}" for name, purpose in purposes.items()]
    show_result(options.json, result, "\n".join(lines))


def _show_scenario(options: argparse.Namespace) -> None:
    from marl_lanes.scenario import load_scenario
    from marl_lanes.scenario.yaml_files import format_yaml

    check_outputs([("--json", options.json)], [options.scenario])
    fields = load_scenario(options.scenario).model_dump(mode="json")
    show_result(options.json, fields, format_yaml(fields).rstrip("\n"))


def _validate(options: argparse.Namespace) -> int:
    check_outputs([("--json", options.json)], options.scenarios)
    import_modules(options.modules)
    problems = {source: _find_problem(source) for source in options.scenarios}
    result = [
        {"scenario": source, "is_valid": problem is None, "problem": problem}
        for source, problem in problems.items()
    ]
    lines = [
        f"{source}: is valid" if problem is None else f"{source}: is not valid: {problem}"
        for source, problem in problems.items()
    ]
    show_result(options.json, result, "\n".join(lines))
    return 1 if any(problems.values()) else 0


def _find_problem(source: str) -> str | None:
    """Why there can be no such scenario, in one line; None if there can be."""
    from marl_lanes.scenario import load_scenario

    try:
        scenario = load_scenario(source)
        if scenario.followers.external_names:
            # Imported here, because other scenarios do not need it.
            from marl_lanes.envs.followers import find_policies
            from marl_lanes.traffic.roles.external import choose_policies

            # A learner may drive those that have no checkpoint.
            is_learned = scenario.followers.learned.checkpoint is None
            choose_policies(scenario, find_policies(scenario), has_learner=is_learned)
    except ValueError as error:
        return str(error)
    return None


def _print_schema(_: argparse.Namespace) -> None:
    from marl_lanes.scenario.json_schema import make_json_schema

    say(json.dumps(make_json_schema(), indent=2))
