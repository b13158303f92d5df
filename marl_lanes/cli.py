"""The ``marl-lanes`` command."""

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import yaml

from marl_lanes.scenario import Scenario, list_scenarios, load_scenario

_UNTRAINED = ("damped-prior", "lane-keeping", "random")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; 0 when it did what was asked, 2 on bad input."""
    options = _make_parser().parse_args(arguments)
    try:
        run: Callable[[argparse.Namespace], None] = options.run
        run(options)
    except (ValueError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


def _make_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="marl-lanes", description="Multi-agent lane changes in interactive highway traffic."
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    scenarios = commands.add_parser(
        "scenarios", help="list the shipped scenarios, or print one in full"
    )
    scenarios.add_argument("scenario", nargs="?", help="a shipped name or the path of a YAML file")
    scenarios.set_defaults(run=_show_scenarios)

    evaluate = commands.add_parser(
        "evaluate",
        help="drive a policy on seeded traffic and measure it against the optimum",
        description="Drive a policy on seeded traffic and print its metrics, which docs/metrics.md "
        "defines.",
    )
    policy = evaluate.add_mutually_exclusive_group(required=True)
    policy.add_argument(
        "checkpoint", nargs="?", type=Path, help="a checkpoint of agents/naf/train.py"
    )
    policy.add_argument("--policy", choices=_UNTRAINED, help="a policy without learning instead")
    evaluate.add_argument("--scenario", default="paper", help="name or YAML file (default: paper)")
    evaluate.add_argument("--maneuvers", type=int, default=1000, help="how many (default: 1000)")
    evaluate.add_argument("--seed", type=int, default=0, help="of the traffic (default: 0)")
    evaluate.add_argument("--json", type=Path, help="write the metrics to this file as well")
    evaluate.set_defaults(run=_evaluate)
    return parser


def _show_scenarios(options: argparse.Namespace) -> None:
    if options.scenario is not None:
        scenario = load_scenario(options.scenario)
        print(yaml.safe_dump(scenario.model_dump(mode="json"), sort_keys=False), end="")
        return
    for name in list_scenarios():
        print(f"{name:12} {load_scenario(name).description}")


def _evaluate(options: argparse.Namespace) -> None:
    # Imported here: `marl-lanes scenarios` and errors in the arguments need none of it.
    from marl_lanes.evaluation.metrics import evaluate
    from marl_lanes.evaluation.rollout import run_maneuvers
    from marl_lanes.training.files import write_json

    if options.json is not None and options.json.is_dir():
        raise ValueError(f"--json {options.json}: must be a file, is a folder")
    scenario = load_scenario(options.scenario)
    name, policy = _make_policy(options, scenario)
    show = _Progress(2 * max(1, options.maneuvers))
    maneuvers = run_maneuvers(
        scenario, policy, options.maneuvers, seed=options.seed, progress=show.driven
    )
    summary = evaluate(maneuvers, scenario, progress=show.measured)
    show.close()
    result = {"scenario": scenario.name, "policy": name, "seed": options.seed, **summary}
    for key, value in result.items():
        print(f"{key:36} {value:.5g}" if isinstance(value, float) else f"{key:36} {value}")
    if options.json is not None:
        write_json(options.json, result)


def _make_policy(options: argparse.Namespace, scenario: Scenario) -> tuple[str, Any]:
    """Name and function of the policy that the options name."""
    from marl_lanes.evaluation import policies

    if options.policy == "random":
        return "random", policies.make_random_policy(scenario, options.seed)
    if options.policy == "lane-keeping":
        return "lane-keeping", policies.make_lane_keeping_policy(scenario)

    import torch

    from marl_lanes.training.checkpoint import greedy_policy, load_checkpoint, make_network

    if options.policy == "damped-prior":
        torch.manual_seed(0)
        return "damped-prior", greedy_policy(make_network(scenario, "damped"))
    return str(options.checkpoint), greedy_policy(
        load_checkpoint(options.checkpoint, scenario).network
    )


class _Progress:
    """A percentage on the terminal; nothing where the output is not one."""

    def __init__(self, total: int) -> None:
        self.total = total
        self.is_shown = sys.stderr.isatty()
        self.last = -1

    def driven(self, count: int) -> None:
        self._show(min(count, self.total // 2))

    def measured(self, count: int) -> None:
        self._show(self.total // 2 + count)

    def _show(self, count: int) -> None:
        percent = 100 * count // self.total
        if self.is_shown and percent != self.last:
            self.last = percent
            print(f"\revaluating {percent:3d} %", end="", file=sys.stderr, flush=True)

    def close(self) -> None:
        if self.is_shown:
            print("\r" + " " * 20 + "\r", end="", file=sys.stderr)
