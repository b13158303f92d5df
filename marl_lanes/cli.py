"""The ``marl-lanes`` command."""

import argparse
import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import yaml

from marl_lanes.scenario import Scenario, list_scenarios, load_scenario
from marl_lanes.scenario.followers import SCRIPTED

_UNTRAINED = ("tuned-cascade", "cascade-prior", "damped-prior", "lane-keeping", "random")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns 0 on success, 2 on bad input."""
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
        help="run a policy on seeded traffic and compare it with the optimum",
        description="Run a policy on seeded traffic, observe every vehicle for 10 s after its "
        "change, and print the metrics that docs/metrics.md defines. The first one is the success "
        "rate: the share of maneuvers that complete and, in these 10 s, do not leave the road, "
        "collide or leave their lane.",
    )
    _add_policy(evaluate, is_required=True)
    _add_traffic(evaluate, num_maneuvers=1000)
    evaluate.set_defaults(run=_evaluate)

    crossplay = commands.add_parser(
        "crossplay",
        help="run every lane changer against every kind of follower",
        description="Run every lane changer against every kind of follower, each pair on the "
        "same seeded traffic, and print the metrics of each pair with 95 % confidence intervals; "
        "docs/metrics.md defines them.",
    )
    crossplay.add_argument(
        "--changers",
        nargs="+",
        required=True,
        metavar="CHANGER",
        help=f"checkpoints, or {', '.join(_UNTRAINED)}; CHANGER@SCENARIO runs on that scenario "
        "instead of --scenario, also with the followers replaced",
    )
    _add_followers(crossplay, required=True)
    _add_traffic(crossplay, num_maneuvers=1000)
    crossplay.add_argument("--figure", type=Path, help="draw heat maps to this file")
    crossplay.set_defaults(run=_crossplay)

    followers = commands.add_parser(
        "followers",
        help="draw the gap behind the same maneuver with every kind of follower",
        description="Run the same seeded maneuver with every kind of follower, draw the gap "
        "behind the lane changer and the follower's acceleration over time, and print the mean "
        "gap at the entry into the lane.",
    )
    _add_policy(followers, is_required=False)
    _add_followers(followers, default=list(SCRIPTED))
    _add_traffic(followers, num_maneuvers=200)
    followers.add_argument(
        "--maneuver",
        type=int,
        help="index of the maneuver to draw, from 0 (default: the first that engages with a "
        "follower near)",
    )
    followers.add_argument("--figure", type=Path, required=True, help="draw to this file")
    followers.set_defaults(run=_compare_followers)
    return parser


def _add_policy(parser: argparse.ArgumentParser, *, is_required: bool) -> None:
    policy = parser.add_mutually_exclusive_group(required=is_required)
    policy.add_argument("checkpoint", nargs="?", help="a checkpoint of a training")
    note = "" if is_required else " (default: tuned-cascade)"
    policy.add_argument(
        "--policy",
        choices=_UNTRAINED,
        help="a policy without learning, instead of a checkpoint" + note,
    )


def _add_followers(parser: argparse.ArgumentParser, **options: Any) -> None:
    note = f" (default: {' '.join(options['default'])})" if "default" in options else ""
    parser.add_argument(
        "--followers",
        nargs="+",
        metavar="FOLLOWER",
        help=f"{', '.join(SCRIPTED)}, learned:CHECKPOINT, or a name given to register_follower"
        + note,
        **options,
    )


def _add_traffic(parser: argparse.ArgumentParser, *, num_maneuvers: int) -> None:
    parser.add_argument("--scenario", default="paper", help="name or YAML file (default: paper)")
    parser.add_argument(
        "--maneuvers",
        type=int,
        default=num_maneuvers,
        help=f"number of maneuvers (default: {num_maneuvers})",
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the traffic (default: 0)")
    parser.add_argument(
        "--import",
        action="append",
        default=[],
        dest="modules",
        metavar="MODULE",
        help="first import this module, which calls register_follower; the current folder is also "
        "searched; may be given more than once",
    )
    parser.add_argument("--json", type=Path, help="also write the results to this file")


def _show_scenarios(options: argparse.Namespace) -> None:
    if options.scenario is not None:
        scenario = load_scenario(options.scenario)
        print(yaml.safe_dump(scenario.model_dump(mode="json"), sort_keys=False), end="")
        return
    for name in list_scenarios():
        print(f"{name:12} {load_scenario(name).description}")


def _evaluate(options: argparse.Namespace) -> None:
    # Imported here, because `marl-lanes scenarios` and errors in the arguments do not need it.
    from marl_lanes.evaluation.metrics import evaluate
    from marl_lanes.evaluation.rollout import run_maneuvers
    from marl_lanes.evaluation.tables import format_summary
    from marl_lanes.files import write_json

    _prepare(options)
    scenario = load_scenario(options.scenario)
    name = options.policy or options.checkpoint
    policy = _make_policy(name, scenario, options.seed)
    number = max(1, options.maneuvers)
    show = _Progress("evaluating", 2 * number)
    maneuvers = run_maneuvers(
        scenario,
        policy,
        options.maneuvers,
        seed=options.seed,
        progress=lambda count: show(min(count, number)),
    )
    summary = evaluate(maneuvers, scenario, progress=lambda count: show(number + count))
    show.close()
    result = {"scenario": scenario.name, "policy": name, "seed": options.seed, **summary}
    print(format_summary(result))
    if options.json is not None:
        write_json(options.json, result)


def _crossplay(options: argparse.Namespace) -> None:
    from marl_lanes.evaluation.crossplay import crossplay
    from marl_lanes.evaluation.tables import format_crossplay
    from marl_lanes.files import write_json

    _prepare(options)
    sources = _label_changers(options.changers)
    changers = {}
    for label, (name, source) in sources.items():
        scenario = load_scenario(source or options.scenario)
        changers[label] = scenario, _make_policy(name, scenario, options.seed)
    followers = _label_followers(options.followers)
    show = _Progress("driving", len(changers) * len(followers) * options.maneuvers)
    result = crossplay(changers, followers, options.maneuvers, seed=options.seed, progress=show)
    show.close()
    print(format_crossplay(result))
    if options.json is not None:
        policies = {label: name for label, (name, _) in sources.items()}
        write_json(options.json, {**result, "policies": policies})
    if options.figure is not None:
        from marl_lanes.evaluation.figures import draw_crossplay

        draw_crossplay(options.figure, result)


def _compare_followers(options: argparse.Namespace) -> None:
    from marl_lanes.evaluation.gaps import compare_followers
    from marl_lanes.evaluation.tables import format_gaps
    from marl_lanes.files import write_json

    _prepare(options)
    from marl_lanes.evaluation.figures import draw_gaps

    scenario = load_scenario(options.scenario)
    name = options.policy or options.checkpoint or "tuned-cascade"
    policy = _make_policy(name, scenario, options.seed)
    followers = _label_followers(options.followers)
    show = _Progress("driving", len(followers) * options.maneuvers)
    result = compare_followers(
        scenario,
        policy,
        followers,
        options.maneuvers,
        seed=options.seed,
        maneuver=options.maneuver,
        progress=show,
    )
    show.close()
    print(format_gaps(result))
    if options.json is not None:
        write_json(options.json, {"policy": name, **result})
    draw_gaps(options.figure, result)


def _prepare(options: argparse.Namespace) -> None:
    """Reject outputs that cannot be written, and import the user's modules."""
    if options.json is not None and options.json.is_dir():
        raise ValueError(f"--json {options.json}: must be a file, not a folder")
    if getattr(options, "figure", None) is not None:
        if find_spec("matplotlib") is None:
            raise ValueError("--figure: needs matplotlib: pip install 'marl-lanes[train]'")
        from marl_lanes.evaluation.figures import check_figure

        check_figure(options.figure)
    # An installed command does not search the current folder for modules by itself.
    folder = str(Path.cwd())
    sys.path.insert(0, folder)
    try:
        for name in options.modules:
            if not all(part.isidentifier() for part in name.split(".")):
                raise ValueError(f"--import {name}: must be the dotted name of a module")
            try:
                import_module(name)
            except ImportError as error:
                raise ValueError(f"--import {name}: {error}") from None
    finally:
        sys.path.remove(folder)


def _make_policy(name: str, scenario: Scenario, seed: int) -> Any:
    """The policy with this name or from this checkpoint; it must fit the scenario."""
    from marl_lanes.evaluation import policies

    if name == "random":
        return policies.make_random_policy(scenario, seed)
    if name == "lane-keeping":
        return policies.make_lane_keeping_policy(scenario)
    if name == "tuned-cascade":
        return policies.make_tuned_cascade_policy(scenario)

    import torch

    from marl_lanes.naf.checkpoint import greedy_policy
    from marl_lanes.training.checkpoint import load_policy, make_network

    if name in _UNTRAINED:
        torch.manual_seed(0)
        lateral = name.removesuffix("-prior")
        mu = lateral if scenario.action.longitudinal is None else f"{lateral}+idm"
        return greedy_policy(make_network(scenario, mu))
    return greedy_policy(load_policy(Path(name), scenario).network)


def _label_changers(entries: Sequence[str]) -> dict[str, tuple[str, str | None]]:
    """Label to policy and scenario; None if the entry names no scenario."""
    _refuse_repeats("--changers", entries)
    found: dict[str, tuple[str, str | None]] = {}
    parts = {}
    for entry in entries:
        name, at, scenario = entry.rpartition("@")
        if not at or Path(entry).is_file():
            name, at, scenario = entry, "", ""
        elif not name or not scenario:
            raise ValueError(f"--changers {entry}: must be CHANGER or CHANGER@SCENARIO")
        found[entry] = name, scenario or None
        *folders, last = (name,) if name in _UNTRAINED else _name_parts(name)
        parts[entry] = (*folders, last + at + Path(scenario).stem)
    labels = _shorten(parts)
    return {labels[entry]: value for entry, value in found.items()}


def _label_followers(entries: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Label to the overrides of a scenario's ``followers``."""
    _refuse_repeats("--followers", entries)
    paths = {}
    for entry in entries:
        name, colon, path = entry.partition(":")
        if colon and (name != "learned" or not path):
            raise ValueError(f"--followers {entry}: must be a name, or learned:CHECKPOINT")
        if colon:
            paths[entry] = path
    labels = _shorten({entry: _name_parts(path) for entry, path in paths.items()})
    found: dict[str, dict[str, Any]] = {}
    for entry in entries:
        if entry in paths:
            override = {"mix": {"learned": 1.0}, "learned": {"checkpoint": paths[entry]}}
            found[f"learned:{labels[entry].removeprefix('learned:')}"] = override
        else:
            found[entry] = {"mix": {entry: 1.0}}
    return found


def _refuse_repeats(option: str, entries: Sequence[str]) -> None:
    for entry, count in Counter(entries).items():
        if count > 1:
            raise ValueError(f"{option} {entry}: must be given once")


def _name_parts(path: str) -> tuple[str, ...]:
    """Parts of a checkpoint's name, the most specific last: run/checkpoints/final.pt is run."""
    file = Path(path)
    folders = [part for part in file.parent.parts if part != file.anchor]
    if len(folders) > 1 and folders[-1] == "checkpoints":
        *folders, run, _ = folders
        return (*folders, run if file.stem == "final" else f"{run}/{file.stem}")
    return (*folders, file.stem)


def _shorten(parts: Mapping[str, Sequence[str]]) -> dict[str, str]:
    """The shortest unique ending of each entry's parts; the entry itself if there is none."""
    depths = dict.fromkeys(parts, 1)
    while True:
        labels = {entry: "/".join(parts[entry][-depth:]) for entry, depth in depths.items()}
        counts = Counter(labels.values())
        shared = [entry for entry, label in labels.items() if counts[label] > 1]
        longer = [entry for entry in shared if depths[entry] < len(parts[entry])]
        if not longer:
            return labels | {entry: entry for entry in shared}
        for entry in longer:
            depths[entry] += 1


class _Progress:
    """Shows a percentage if stderr is a terminal."""

    def __init__(self, activity: str, total: int) -> None:
        self.activity = activity
        self.total = total
        self.is_shown = sys.stderr.isatty()
        self.last = -1

    def __call__(self, count: int) -> None:
        percent = 100 * count // self.total
        if self.is_shown and percent != self.last:
            self.last = percent
            print(f"\r{self.activity} {percent:3d} %", end="", file=sys.stderr, flush=True)

    def close(self) -> None:
        if self.is_shown:
            print("\r" + " " * 20 + "\r", end="", file=sys.stderr)
