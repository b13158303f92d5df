"""The public API, as lines of text: what users may rely on.

``tests/public_api.txt`` holds it. Where a change of it is meant, write it anew with ``python
tests/public_api.py``, and tell of the change in CHANGELOG.md.
"""

import argparse
import inspect
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, get_args, get_origin

from pydantic import BaseModel

import marl_lanes
from marl_lanes import Scenario
from marl_lanes.cli.main import make_parser
from marl_lanes.trajectory.columns import COLUMNS

FILE = Path(__file__).with_suffix(".txt")


def commands() -> dict[str, list[argparse.Action]]:
    """The arguments of each command."""
    parsers: Any = next(
        action for action in make_parser()._actions if isinstance(action.choices, Mapping)
    )
    return {name: parser._actions for name, parser in parsers.choices.items()}


def describe() -> str:
    """All of it."""
    lines = []
    for name in marl_lanes.__all__:
        lines += _describe(name, getattr(marl_lanes, name))
    for command, actions in commands().items():
        lines += [f"marl-lanes {command} {_argument(action)}" for action in actions]
    lines += [f"scenario {name}" for name in _fields(Scenario)]
    lines += [
        f"trajectory {column.name}: {column.kind} [{column.unit}]"
        f"{' or missing' if column.is_optional else ''}"
        for column in COLUMNS
    ]
    return "\n".join(lines) + "\n"


def _describe(name: str, value: Any) -> Iterator[str]:
    if not inspect.isclass(value):
        yield f"{name}{_signature(value)}" if inspect.isroutine(value) else f"{name}: {value!r}"
        return
    bases = ", ".join(base.__name__ for base in value.__bases__ if base is not object)
    yield f"{name} is a {bases or 'class'}"
    # The fields of a scenario are listed by themselves.
    if issubclass(value, BaseModel):
        return
    for attribute in sorted(_attributes(value)):
        member = inspect.getattr_static(value, attribute)
        plain = getattr(member, "__func__", member)
        yield f"{name}.{attribute}{_signature(plain) if inspect.isroutine(plain) else ''}"


def _attributes(kind: type) -> set[str]:
    """Public names that this package defines, also in a base, and how objects are made."""
    own = [one for one in kind.__mro__ if one.__module__.startswith("marl_lanes")]
    special = {"__init__", "__call__"}
    return {name for one in own for name in vars(one) if name in special or name[0] != "_"}


def _signature(function: Any) -> str:
    """Parameters by name, kind and default; annotations may become more exact."""
    parameters = [
        parameter.replace(annotation=inspect.Parameter.empty)
        for parameter in inspect.signature(function).parameters.values()
    ]
    return str(inspect.Signature(parameters))


def _argument(action: argparse.Action) -> str:
    name = " ".join(action.option_strings) or str(action.metavar or action.dest)
    number = {None: "", 0: " (no value)"}.get(action.nargs, f" ({action.nargs})")
    # Whether what may be given no time is required, versions of Python differ.
    is_required = action.required and action.nargs != "*"
    return name + number + (", required" if is_required else "")


def _fields(kind: type[BaseModel], prefix: str = "") -> Iterator[str]:
    """Dotted names: [] for entries of lists, * for entries of maps."""
    for name, field in kind.model_fields.items():
        inner: Any = field.annotation
        mark = {dict: ".*.", tuple: "[]."}.get(get_origin(inner), ".")
        sections = [
            one
            for one in (inner, *get_args(inner))
            if inspect.isclass(one) and issubclass(one, BaseModel)
        ]
        if not sections:
            yield prefix + name
        for section in sections:
            yield from _fields(section, prefix + name + mark)


if __name__ == "__main__":
    FILE.write_text(describe(), encoding="utf-8")
