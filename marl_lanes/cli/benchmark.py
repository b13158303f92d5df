"""The commands of the benchmark: measure a policy on its tasks, and show what was measured."""

import argparse
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from marl_lanes.cli.arguments import Commands, add_command, add_json
from marl_lanes.cli.completers import offer, policies
from marl_lanes.cli.outputs import check_outputs, show_result
from marl_lanes.cli.policies import TRAINED, UNTRAINED, find_training, make_policy
from marl_lanes.cli.progress import Progress
from marl_lanes.cli.values import MAX_SEED, file_name, whole_number
from marl_lanes.evaluation.tasks import NUM_MANEUVERS, SEED, TASKS
from marl_lanes.plugins import add_import, import_modules
from marl_lanes.terminal import say

if TYPE_CHECKING:
    from marl_lanes.scenario import Scenario


def add(commands: Commands) -> None:
    """Add ``benchmark`` and ``benchmark-table``."""
    _add_benchmark(commands)
    _add_table(commands)


def _add_benchmark(commands: Commands) -> None:
    benchmark = add_command(
        commands,
        "benchmark",
        _benchmark,
        summary="measure a policy on the tasks of the benchmark",
        description="Drive a policy on each task of the benchmark that it fits, and print its "
        "numbers with 95 % confidence intervals; docs/benchmark.md has the rules. MODULE:FUNCTION "
        "imports the module, also from the current folder, and so runs its code; the function is "
        "given the scenario, and returns a policy: observations (N, F) to actions (N, D).",
        examples="""
            marl-lanes benchmark zoo:paper --json rows.json
            marl-lanes benchmark tuned-cascade --task paper dense --maneuvers 100
            marl-lanes benchmark mine:make --label mine
        """,
    )
    policy = f"{', '.join(UNTRAINED)}, {TRAINED}"
    offer(benchmark.add_argument("policy", metavar="POLICY", help=policy), policies)
    benchmark.add_argument(
        "--task",
        nargs="+",
        choices=TASKS,
        dest="tasks",
        metavar="TASK",
        help=f"only these of {', '.join(TASKS)}, and the policy must fit them (default: all that "
        "it fits)",
    )
    benchmark.add_argument(
        "--maneuvers",
        type=whole_number(1),
        default=NUM_MANEUVERS,
        help=f"number of maneuvers of each task (default: {NUM_MANEUVERS})",
    )
    benchmark.add_argument(
        "--seed",
        type=whole_number(0, MAX_SEED),
        default=SEED,
        help=f"seed of the traffic (default: {SEED})",
    )
    benchmark.add_argument("--label", help="the policy's name in the rows (default: POLICY)")
    add_import(benchmark)
    add_json(benchmark)


def _add_table(commands: Commands) -> None:
    table = add_command(
        commands,
        "benchmark-table",
        _show_table,
        summary="show the benchmark's rows of many policies as tables",
        description="Show rows of the benchmark as tables in Markdown, one for each task: what "
        "`marl-lanes benchmark --json FILE` wrote, of any number of policies.",
        examples="""
            marl-lanes benchmark-table rows.json others.json
            marl-lanes benchmark-table docs/benchmark/*.json --page docs/benchmark.md
        """,
    )
    table.add_argument("rows", nargs="+", type=file_name, metavar="FILE", help="files of rows")
    table.add_argument(
        "--page",
        type=file_name,
        help="put the tables into this page, between its two lines for them, as docs/benchmark.md "
        "has; do not print them",
    )


def _benchmark(options: argparse.Namespace) -> None:
    from marl_lanes.evaluation.benchmark import Row, measure_row
    from marl_lanes.evaluation.benchmark_tables import dump_rows, format_rows

    name: str = options.policy
    check_outputs([("--json", options.json)], [name])
    import_modules(options.modules)
    fitting, refused = _find_tasks(name, options.tasks, options.seed)
    training = find_training(name)
    label = options.label or name
    number, rows = options.maneuvers, dict[str, Row]()
    with Progress("driving", 2 * number * len(fitting)) as show:
        for count, (task, (scenario, policy)) in enumerate(fitting.items()):

            def advance(done: int, before: int = 2 * number * count) -> None:
                show(before + done)

            rows[task] = measure_row(
                label,
                task,
                scenario,
                policy,
                number,
                seed=options.seed,
                training=training,
                progress=advance,
            )
    for task, reason in refused.items():
        rows[task] = Row(
            policy=label,
            task=task,
            version=version("marl-lanes"),
            seed=options.seed,
            does_not_fit=reason,
        )
    ordered = [rows[task] for task in TASKS if task in rows]
    show_result(options.json, dump_rows(ordered), format_rows(ordered))


def _find_tasks(
    name: str, tasks: list[str] | None, seed: int
) -> "tuple[dict[str, tuple[Scenario, Any]], dict[str, str]]":
    """The tasks that a policy fits, each with its scenario and the policy; and why not the others.

    Raises:
        ValueError: it fits none, or not one that was asked for.
    """
    from marl_lanes.scenario import load_scenario

    fitting: dict[str, tuple[Scenario, Any]] = {}
    refused: dict[str, str] = {}
    for task in tasks or TASKS:
        scenario = load_scenario(task)
        try:
            fitting[task] = scenario, make_policy(name, scenario, seed)
        except ValueError as error:
            if tasks:
                raise
            refused[task] = str(error)
    if not fitting:
        raise ValueError(next(iter(refused.values())))
    return fitting, refused


def _show_table(options: argparse.Namespace) -> None:
    from marl_lanes.evaluation.benchmark_tables import format_markdown, read_rows, write_page

    page: Path | None = options.page
    check_outputs([("--page", page)], options.rows)
    rows = [row for path in options.rows for row in read_rows(path)]
    if page is None:
        say(format_markdown(rows))
    else:
        write_page(page, rows)
