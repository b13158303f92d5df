"""Commands that drive policies on seeded traffic and compare what they achieve."""

import argparse

from marl_lanes.cli.arguments import (
    Commands,
    add_command,
    add_figure,
    add_followers,
    add_json,
    add_policy,
    add_traffic,
)
from marl_lanes.cli.completers import offer, policies
from marl_lanes.cli.names import label_changers, label_followers, saved_followers
from marl_lanes.cli.outputs import check_figures, check_outputs, check_trajectories, show_result
from marl_lanes.cli.policies import TRAINED, UNTRAINED, make_policy
from marl_lanes.cli.progress import Progress
from marl_lanes.cli.values import file_name, whole_number
from marl_lanes.plugins import add_import, import_modules
from marl_lanes.scenario.dispositions import SCRIPTED


def add(commands: Commands) -> None:
    """Add ``evaluate``, ``crossplay`` and ``followers``."""
    _add_evaluate(commands)
    _add_crossplay(commands)
    _add_comparison_of_followers(commands)


def _add_evaluate(commands: Commands) -> None:
    evaluate = add_command(
        commands,
        "evaluate",
        _evaluate,
        summary="measure a policy on seeded traffic, and the optimum",
        description="Run a policy on seeded traffic, observe every vehicle for 10 s after its "
        "change, and print the metrics that docs/metrics.md defines. The first one is the success "
        "rate: the share of maneuvers that complete and, in these 10 s, do not leave the road, "
        "collide or leave their lane.",
        examples="""
            marl-lanes evaluate zoo:paper
            marl-lanes evaluate --policy tuned-cascade --scenario dense --maneuvers 200
            marl-lanes evaluate runs/paper/checkpoints/final.pt --json evaluation.json
            marl-lanes evaluate mine:make --trajectories roads.parquet
        """,
    )
    add_policy(evaluate, is_required=True)
    add_traffic(evaluate, num_maneuvers=1000)
    add_import(evaluate)
    add_json(evaluate)
    evaluate.add_argument(
        "--trajectories",
        type=file_name,
        metavar="FILE",
        help="also record all roads to this file (.parquet), for `marl-lanes record` and others",
    )


def _add_crossplay(commands: Commands) -> None:
    crossplay = add_command(
        commands,
        "crossplay",
        _crossplay,
        summary="drive every lane changer against every kind of follower",
        description="Run every lane changer against every kind of follower, each pair on the "
        "same seeded traffic, and print the metrics of each pair with 95 % confidence intervals; "
        "docs/metrics.md defines them.",
        examples="""
            marl-lanes crossplay --changers tuned-cascade zoo:paper --followers neutral \\
                adversarial brake-checker --scenario dense --figure crossplay.png
            marl-lanes crossplay --changers zoo:interactive@interactive \\
                --followers learned:zoo:adversary --json -
        """,
    )
    changers = crossplay.add_argument(
        "--changers",
        nargs="+",
        required=True,
        metavar="CHANGER",
        help=f"{', '.join(UNTRAINED)}, {TRAINED}; CHANGER@SCENARIO runs on that scenario instead "
        "of --scenario, also with the followers replaced",
    )
    offer(changers, policies)
    add_followers(crossplay, required=True)
    add_traffic(crossplay, num_maneuvers=1000)
    add_import(crossplay)
    add_json(crossplay)
    add_figure(crossplay, "heat maps", is_required=False)


def _add_comparison_of_followers(commands: Commands) -> None:
    followers = add_command(
        commands,
        "followers",
        _compare_followers,
        summary="draw the same maneuver with every kind of follower",
        description="Run the same seeded maneuver with every kind of follower, draw the gap "
        "behind the lane changer and the follower's acceleration over time, and print the mean "
        "gap at the entry into the lane.",
        examples="""
            marl-lanes followers --scenario dense --figure followers.png
            marl-lanes followers zoo:paper --followers neutral late-yielder \\
                --maneuver 4 --figure followers.svg
        """,
    )
    add_policy(followers, is_required=False)
    add_followers(followers, default=list(SCRIPTED))
    add_traffic(followers, num_maneuvers=200)
    add_import(followers)
    add_json(followers)
    followers.add_argument(
        "--maneuver",
        type=whole_number(),
        help="index of the maneuver to draw, from 0 (default: the first that engages with a "
        "follower near)",
    )
    add_figure(followers, "gap and acceleration", is_required=True)


def _evaluate(options: argparse.Namespace) -> None:
    # Imported here, because `marl-lanes scenarios` and errors in the arguments do not need it.
    from marl_lanes.evaluation.metrics import evaluate
    from marl_lanes.evaluation.recording import record_maneuvers
    from marl_lanes.evaluation.tables import format_summary
    from marl_lanes.scenario import load_scenario

    name = options.policy or options.checkpoint
    outputs = [("--json", options.json), ("--trajectories", options.trajectories)]
    check_outputs(outputs, [name, options.scenario])
    check_trajectories(options.trajectories)
    import_modules(options.modules)
    scenario = load_scenario(options.scenario)
    policy = make_policy(name, scenario, options.seed)
    number = options.maneuvers
    with Progress("evaluating", 2 * number) as show:
        maneuvers = record_maneuvers(
            options.trajectories,
            name,
            scenario,
            policy,
            number,
            seed=options.seed,
            progress=lambda count: show(min(count, number)),
        )
        summary = evaluate(maneuvers, scenario, progress=lambda count: show(number + count))
    result = {"scenario": scenario.name, "policy": name, "seed": options.seed, **summary}
    show_result(options.json, result, format_summary(result))


def _crossplay(options: argparse.Namespace) -> None:
    from marl_lanes.evaluation.crossplay import crossplay
    from marl_lanes.evaluation.tables import format_crossplay
    from marl_lanes.scenario import load_scenario

    sources = label_changers(options.changers)
    followers = label_followers(options.followers)
    outputs = [("--json", options.json), *(("--figure", path) for path in options.figures)]
    inputs = [options.scenario, *saved_followers(followers)]
    check_outputs(outputs, [*inputs, *(part for source in sources.values() for part in source)])
    check_figures(options.figures)
    import_modules(options.modules)
    changers = {}
    for label, (name, source) in sources.items():
        scenario = load_scenario(source or options.scenario)
        changers[label] = scenario, make_policy(name, scenario, options.seed)
    with Progress("driving", len(changers) * len(followers) * options.maneuvers) as show:
        result = crossplay(changers, followers, options.maneuvers, seed=options.seed, progress=show)
    if options.figures:
        from marl_lanes.evaluation.figures import draw_crossplay

        draw_crossplay(options.figures, result)
    names = {label: name for label, (name, _) in sources.items()}
    show_result(options.json, {**result, "policies": names}, format_crossplay(result))


def _compare_followers(options: argparse.Namespace) -> None:
    from marl_lanes.evaluation.gaps import compare_followers
    from marl_lanes.evaluation.tables import format_gaps
    from marl_lanes.scenario import load_scenario

    name = options.policy or options.checkpoint or "tuned-cascade"
    followers = label_followers(options.followers)
    outputs = [("--json", options.json), *(("--figure", path) for path in options.figures)]
    check_outputs(outputs, [name, options.scenario, *saved_followers(followers)])
    check_figures(options.figures)
    import_modules(options.modules)
    from marl_lanes.evaluation.figures import draw_gaps

    scenario = load_scenario(options.scenario)
    policy = make_policy(name, scenario, options.seed)
    with Progress("driving", len(followers) * options.maneuvers) as show:
        result = compare_followers(
            scenario,
            policy,
            followers,
            options.maneuvers,
            seed=options.seed,
            maneuver=options.maneuver,
            progress=show,
        )
    draw_gaps(options.figures, result)
    show_result(options.json, {"policy": name, **result}, format_gaps(result))
