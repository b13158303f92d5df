"""Overrides on a program's command line: refused where they would be ignored or not understood."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException
from pydantic import BaseModel

from marl_lanes.scenario.messages import fields_at, shown, unknown_key
from marl_lanes.scenario.schema import Scenario
from marl_lanes.training.config import ConfigError

SCENARIO_FIELDS = "training_overrides"
"""The field whose keys are those of a scenario."""

MAX_LENGTH = 4096
"""[characters] of an override; hydra reads it slowly."""

BESIDE_RESUME = ("resume", "ray.address")
"""All that a resumed run takes from the command line."""


def check_overrides(kind: type[BaseModel], folder: Path, texts: Sequence[str]) -> list[str]:
    """Refuse what hydra would ignore, or would explain in many lines.

    Args:
        kind: the program's configuration.
        folder: folder of the YAML files; a folder in it is a group of files to choose from.
        texts: ``FIELD=VALUE``, ``+FIELD=VALUE``, ``++FIELD=VALUE``, ``~FIELD``, ``GROUP=FILE``.

    Returns:
        the key of each, dotted.

    Raises:
        ConfigError: one cannot be read, has a key that the program does not have, is given twice,
            or stands beside ``resume``.
    """
    before: dict[str, str] = {}
    for text in texts:
        override = _parse(text)
        key = override.key_or_group.replace("/", ".")
        value = override.value()
        for path in _leaves(key, value):
            _check_key(kind, path.split("."))
            if path in before:
                raise ConfigError(f"{shown(text)}: {path} is given twice, before by {before[path]}")
            before[path] = shown(text)
        options = sorted(file.stem for file in (folder / key).glob("*.yaml"))
        if options and not isinstance(value, Mapping) and value not in options:
            raise ConfigError(f"{key} = {shown(value)}: must be {', '.join(options)}")
        if override.is_delete() and key.partition(".")[0] in kind.model_fields:
            _check_deletion(kind, key)
        if key == "resume" and value is not None:
            _check_alone(shown(value), texts)
    return list(before)


def _parse(text: str) -> Override:
    if len(text) > MAX_LENGTH:
        raise ConfigError(f"{shown(text)}: must have at most {MAX_LENGTH} characters")
    try:
        (override,) = OverridesParser.create().parse_overrides([text])
    except (HydraException, RecursionError) as error:
        reason = " ".join(str(error).partition("\nSee https")[0].split())
        raise ConfigError(
            f"{shown(text)}: must be FIELD=VALUE in the syntax of hydra: {shown(reason)}"
        ) from None
    if not override.key_or_group or override.package is not None:
        raise ConfigError(f"{shown(text)}: must be FIELD=VALUE, with the name of a field")
    if override.is_sweep_override():
        raise ConfigError(
            f"{shown(text)}: must have one value; a list is [a,b], a text with a comma has quotes"
        )
    return override


def _leaves(key: str, value: Any) -> Iterator[str]:
    """The dotted keys of all values."""
    if isinstance(value, Mapping) and value:
        for name, inner in value.items():
            yield from _leaves(f"{key}.{name}", inner)
    else:
        yield key


def _check_key(kind: type[BaseModel], path: Sequence[str]) -> None:
    if path[0] == SCENARIO_FIELDS and len(path) > 1 and SCENARIO_FIELDS in kind.model_fields:
        _check_below(Scenario, path[1:], f"{SCENARIO_FIELDS}.")
    else:
        _check_below(kind, path, "")


def _check_below(kind: type[BaseModel], path: Sequence[str], prefix: str) -> None:
    for place, part in enumerate(path):
        allowed = fields_at(kind, path[:place])
        if allowed is not None and part not in allowed:
            raise ConfigError(unknown_key(prefix + ".".join(path[: place + 1]), allowed))


def _check_deletion(kind: type[BaseModel], key: str) -> None:
    """Only what is in a mapping of free keys can be left out."""
    above, _, name = key.rpartition(".")
    if name in (fields_at(kind, above.split(".") if above else []) or ()):
        raise ConfigError(f"~{key}: {key} must be given; it can be set, and not taken out")


def _check_alone(run: str, texts: Sequence[str]) -> None:
    others = [
        text for text in texts if _parse(text).key_or_group.replace("/", ".") not in BESIDE_RESUME
    ]
    if others:
        raise ConfigError(
            f"resume = {run}: must be alone, for a resumed run keeps its own config; beside it is "
            f"{shown(others[0])}"
        )
