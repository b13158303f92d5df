"""Tables of results in Markdown documents: written by the command that measured them."""

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from marl_lanes.files import write_text
from marl_lanes.scenario.messages import shown

Cell = str | float | int | None


def format_table(rows: Sequence[Mapping[str, Cell]]) -> str:
    """Rows as a Markdown table; the keys of the first are its head.

    Numbers have four significant digits; None is ``-``.
    """
    head = list(rows[0])
    lines = [head, ["---"] * len(head), *([_format(row[key]) for key in head] for row in rows)]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def check_document(path: Path, names: Iterable[str]) -> None:
    """Refuse a document without places for these tables: a long work should not end with that.

    Raises:
        ValueError: a place is missing.
        OSError: it cannot be read.
    """
    text = path.read_text(encoding="utf-8")
    for name in names:
        if not re.search(_place(name), text, re.DOTALL):
            raise ValueError(
                f"document {shown(str(path))}: must have the lines <!-- {name} --> and "
                f"<!-- end of {name} -->, between which the table goes"
            )


def insert_tables(path: Path, tables: Mapping[str, str]) -> None:
    """Replace what is between ``<!-- NAME -->`` and ``<!-- end of NAME -->`` by each table.

    Args:
        path: of the document.
        tables: Markdown by name.

    Raises:
        ValueError: a place is missing; the document stays as it was.
        OSError: it cannot be read or written.
    """
    check_document(path, tables)
    text = path.read_text(encoding="utf-8")
    for name, table in tables.items():
        filled = f"<!-- {name} -->\n\n{table}\n<!-- end of {name} -->"
        before, _, after = re.split(f"({_place(name)})", text, maxsplit=1, flags=re.DOTALL)
        text = f"{before}{filled}{after}"
    write_text(path, text)


def _place(name: str) -> str:
    return rf"<!-- {re.escape(name)} -->\n.*?<!-- end of {re.escape(name)} -->"


def _format(cell: Cell) -> str:
    if cell is None:
        return "-"
    if isinstance(cell, float):
        return f"{cell:.4g}" if abs(cell) < 1e4 else f"{cell:,.0f}"
    return f"{cell:,}" if isinstance(cell, int) else cell
