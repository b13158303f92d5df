"""Rows of the benchmark: their file, and the tables that show them, success first."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

from pydantic import TypeAdapter, ValidationError

from marl_lanes.evaluation.benchmark import NUM_AGENTS, Row
from marl_lanes.evaluation.tables import PER_CENT, choose_decimals, format_estimate, format_table
from marl_lanes.evaluation.tasks import TASKS
from marl_lanes.files import open_regular, write_text
from marl_lanes.scenario.messages import shown_name

Column: TypeAlias = tuple[str, str, float, int]

OUTCOMES: Sequence[Column] = (
    ("success_rate", "success [%]", PER_CENT, 1),
    ("cost_ratio", "cost ratio", 1.0, 3),
    ("missed_rate", "missed [%]", PER_CENT, 1),
    ("lost_rate", "lost [%]", PER_CENT, 1),
    ("collided_rate", "collided [%]", PER_CENT, 1),
    ("left_lane_rate", "left its lane [%]", PER_CENT, 1),
    ("horizon_rate", "cut off [%]", PER_CENT, 1),
    ("mean_time_to_completion", "time to complete [s]", 1.0, 2),
)
COMFORT: Sequence[Column] = (
    ("mean_peak_lateral_acceleration", "lateral acceleration [m/s^2]", 1.0, 2),
    ("mean_peak_lateral_jerk", "lateral jerk [m/s^3]", 1.0, 2),
    ("mean_peak_longitudinal_jerk", "longitudinal jerk [m/s^3]", 1.0, 2),
    ("mean_imposed_on_follower", "imposed on follower [m/s^2]", 1.0, 2),
)
"""Key, title, factor and decimals of the statistics, in the order of the tables."""

BEGIN = "<!-- begin: marl-lanes benchmark-table -->"
END = "<!-- end: marl-lanes benchmark-table -->"
"""The lines of a page between which the table is."""

_ROWS = TypeAdapter(list[Row])
_NONE = "-"


class BenchmarkError(ValueError):
    """A file that holds no rows, or a page without a place for the table."""


def dump_rows(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Rows as plain values."""
    dumped: list[dict[str, Any]] = _ROWS.dump_python(list(rows), mode="json")
    return dumped


def read_rows(path: Path) -> list[Row]:
    """The rows of a file of ``dump_rows`` as JSON.

    Raises:
        BenchmarkError: it cannot be read, or holds something else.
    """
    try:
        with open_regular(path) as file:
            return _ROWS.validate_json(file.read())
    except OSError as error:
        reason = error.strerror or str(error)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        reason = ": ".join(filter(None, [".".join(map(str, first["loc"])), first["msg"]]))
    raise BenchmarkError(f"rows {shown_name(path)}: {reason}")


def format_rows(rows: Sequence[Row]) -> str:
    """For a terminal: one column for each task that the policy fits, and a line for each other."""
    fitting = [row for row in rows if row.does_not_fit is None]
    parts = [f"{row.task}: {_refusal(row)}" for row in rows if row.does_not_fit is not None]
    if fitting:
        lines = [
            [title, *(_statistic(row, key, factor, decimals) for row in fitting)]
            for key, title, factor, decimals in (*OUTCOMES, *COMFORT)
        ]
        for number in NUM_AGENTS:
            times = [f"{row.decision_microseconds[number]:.1f}" for row in fitting]
            lines.append([f"decision, {_agents(number)} [us]", *times])
        head = f"{fitting[0].policy}; {fitting[0].num_maneuvers} maneuvers of each task, seed "
        head += f"{fitting[0].seed}; value [95 % interval]"
        parts.insert(0, f"{head}\n\n{format_table(['', *(row.task for row in fitting)], lines, 1)}")
        parts += [
            f"{row.task}: no cost ratio: {row.no_cost_ratio}"
            for row in fitting
            if row.no_cost_ratio
        ]
    return "\n\n".join(parts)


def format_markdown(rows: Sequence[Row]) -> str:
    """For a page: two tables for each task, the best success first, then the lowest cost ratio."""
    parts = []
    for task in [*TASKS, *dict.fromkeys(row.task for row in rows if row.task not in TASKS)]:
        of_task = sorted((row for row in rows if row.task == task), key=_order)
        if of_task:
            parts.append(f"### {task}\n\n{_tables(of_task)}")
    return "\n\n".join(parts)


def write_page(path: Path, rows: Sequence[Row]) -> None:
    """Put the tables in the place of those on a page.

    Raises:
        BenchmarkError: the page cannot be read, or has no place for them.
    """
    try:
        with open_regular(path) as file:
            text = file.read().decode()
    except (OSError, UnicodeDecodeError) as error:
        raise BenchmarkError(f"page {shown_name(path)}: cannot be read: {error}") from None
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise BenchmarkError(f"page {shown_name(path)}: must have the lines {BEGIN} and {END}")
    write_text(path, f"{before}{BEGIN}\n\n{format_markdown(rows)}\n\n{END}{after}")


def _tables(rows: Sequence[Row]) -> str:
    """How commands ended; and what the changes were like, beside the success."""
    times = [f"decision, {_agents(number)} [us]" for number in NUM_AGENTS]
    ended = [["policy", "maneuvers", *(title for _, title, _, _ in OUTCOMES)]]
    driven = [["policy", *(title for _, title, _, _ in (OUTCOMES[0], *COMFORT)), *times]]
    driven[0] += ["transitions", "demonstrations", "training [s]"]
    for row in rows:
        name = f"`{row.policy}`".replace("|", "\\|")
        if row.does_not_fit is not None:
            ended.append([name, "does not fit", *[""] * len(OUTCOMES)])
            continue
        ended.append([name, f"{row.num_maneuvers:,}", *_statistics(row, OUTCOMES)])
        decisions = [f"{row.decision_microseconds[number]:.1f}" for number in NUM_AGENTS]
        driven.append(
            [name, *_statistics(row, (OUTCOMES[0], *COMFORT)), *decisions, *_learned(row)]
        )
    return "\n\n".join(_table(lines) for lines in (ended, driven) if len(lines) > 1)


def _table(lines: Sequence[Sequence[str]]) -> str:
    head, *rest = lines
    return "\n".join(f"| {' | '.join(line)} |" for line in (head, ["---"] * len(head), *rest))


def _learned(row: Row) -> list[str]:
    training = row.training
    if training is None:
        return [_NONE] * 3
    seconds = _NONE if training.seconds is None else f"{training.seconds:.0f}"
    return [f"{training.transitions:,}", f"{training.demonstrations:,}", seconds]


def _statistics(row: Row, columns: Sequence[Column]) -> list[str]:
    return [_statistic(row, key, factor, decimals) for key, _, factor, decimals in columns]


def _statistic(row: Row, key: str, factor: float, decimals: int) -> str:
    found = row.statistics[key]
    values: Mapping[str, float | None] = {
        "value": found.value,
        "low": found.low,
        "high": found.high,
    }
    return format_estimate(values, factor, choose_decimals(decimals, factor, row.num_maneuvers))


def _order(row: Row) -> tuple[float, float, str]:
    success, cost = (row.statistics.get(key) for key in ("success_rate", "cost_ratio"))
    return (
        1.0 if success is None or success.value is None else -success.value,
        float("inf") if cost is None or cost.value is None else cost.value,
        row.policy,
    )


def _refusal(row: Row) -> str:
    return f"does not fit: {row.does_not_fit}"


def _agents(number: int) -> str:
    return f"{number} agent{'s' if number > 1 else ''}"
