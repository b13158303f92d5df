"""Scenarios by name, from a YAML file or from a mapping."""

from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ValidationError

from marl_lanes.scenario.messages import explain, shown, shown_name
from marl_lanes.scenario.schema import Scenario
from marl_lanes.scenario.yaml_files import MAX_DEPTH, MAX_VALUES, YamlError, read_yaml
from marl_lanes.zoo.index import PREFIX

_WHOLE = {("drivers", "mix"), ("followers", "mix")}
"""Mappings that are replaced as a whole: their shares are relative to each other."""


class ScenarioError(ValueError):
    """An invalid scenario: the message names each field, its value and the allowed values."""


def list_scenarios() -> list[str]:
    """Names of the shipped scenarios, sorted."""
    folder = resources.files("marl_lanes.scenarios")
    return sorted(
        entry.name.removesuffix(".yaml")
        for entry in folder.iterdir()
        if entry.name.endswith(".yaml")
    )


def load_scenario(
    source: str | Path | Mapping[str, Any] | Scenario = "paper",
    overrides: Mapping[str, Any] | None = None,
) -> Scenario:
    """A scenario: the defaults, replaced by the source's fields, replaced by the overrides.

    One rule holds for both steps. Of a section and of a driver profile only the fields that are
    named are replaced; lists and a ``mix`` as a whole. A new driver profile begins with the default
    values of ``normal``.

    Args:
        source: a name of ``list_scenarios()``, the path of a YAML file (a ``Path``, or a string
            with a path separator or the suffix ``.yaml`` or ``.yml``), a mapping of fields, or a
            scenario, which has all fields. Numbers and arrays of numpy are as Python's.
        overrides: fields, nested as in the YAML.

    Raises:
        ScenarioError: no such scenario or file, or invalid fields; the message names each field,
            its value and the allowed values. Also a checkpoint that a file names outside of the
            file's folder.
    """
    if not (overrides is None or isinstance(overrides, Mapping)):
        raise ScenarioError(f"overrides = {shown(overrides)}: must be a mapping of fields, or None")
    if isinstance(source, Scenario):
        if not overrides:
            return source
        origin, fields = f"scenario {source.name!r}", source.model_dump(mode="json")
    else:
        origin, named = _read(source)
        fields = _merge(Scenario(name="custom").model_dump(mode="json"), named)
    try:
        return Scenario.model_validate(_merge(fields, _copy(overrides or {}, origin)))
    except ValidationError as error:
        raise ScenarioError(f"{origin}: {explain(error, Scenario)}") from None


def _read(source: object) -> tuple[str, dict[str, Any]]:
    """What messages call the source, and its fields."""
    if isinstance(source, Mapping):
        origin = "scenario from a mapping"
        return origin, _copy(source, origin)
    if isinstance(source, str) and not source.endswith((".yaml", ".yml")) and "/" not in source:
        names = list_scenarios()
        if source not in names:
            raise ScenarioError(
                f"scenario {shown(source)}: no such scenario; allowed: {', '.join(names)}, or the "
                "path of a .yaml file"
            )
        origin = f"scenario {source!r}"
        file = resources.files("marl_lanes.scenarios").joinpath(f"{source}.yaml")
        with resources.as_file(file) as path:
            return origin, _read_file(path, origin)
    if isinstance(source, str | Path):
        path = Path(source)
        origin = f"scenario file {shown_name(path)}"
        fields = _read_file(path, origin)
        _place_checkpoint(fields, path.parent, origin)
        return origin, fields
    raise ScenarioError(
        f"scenario = {shown(source)}: must be a name, the path of a .yaml file, a mapping of "
        "fields, or a Scenario"
    )


def _read_file(path: Path, origin: str) -> dict[str, Any]:
    try:
        fields = read_yaml(path)
    except YamlError as error:
        raise ScenarioError(f"{origin}: {error}") from None
    if not isinstance(fields, dict):
        raise ScenarioError(f"{origin}: must be a mapping of fields, got {shown(fields)}")
    return {"name": path.stem} | _copy(fields, origin)


def _place_checkpoint(fields: dict[str, Any], folder: Path, origin: str) -> None:
    """Let a checkpoint's path begin at the scenario's folder; refuse one that leaves it.

    A scenario of a stranger must not choose which files are opened. A policy of the zoo is no path.
    """
    match fields:
        case {"followers": {"learned": {"checkpoint": str(name)} as learned}} if name:
            if name.startswith(PREFIX):
                return
            try:
                path = (folder / name).resolve()
                # Windows finds no fault with a character that no path has.
                is_inside = "\0" not in name and path.is_relative_to(folder.resolve())
            except (ValueError, RuntimeError):
                # That character, or a circle of links.
                is_inside = False
            if not is_inside:
                raise ScenarioError(
                    f"{origin}: followers.learned.checkpoint = {shown(name)}: must be in the "
                    "folder of the scenario file or below it; any other may be in overrides"
                )
            learned["checkpoint"] = str(path)


def _copy(fields: Mapping[str, Any], origin: str) -> dict[str, Any]:
    """The fields as Python's types: text as keys, no numbers and arrays of numpy."""
    values = iter(range(MAX_VALUES))

    def copy(value: Any, path: tuple[str, ...]) -> Any:
        if next(values, None) is None or len(path) > MAX_DEPTH:
            raise ScenarioError(
                f"{origin}: must have at most {MAX_VALUES:,} values, nested at most {MAX_DEPTH} "
                "levels deep"
            )
        if isinstance(value, BaseModel):
            value = value.model_dump(mode="json")
        elif isinstance(value, np.generic | np.ndarray) and value.size <= MAX_VALUES:
            value = value.tolist()
        if isinstance(value, Mapping):
            for key in value:
                if not isinstance(key, str):
                    place = "".join(f"{shown_name(part)}." for part in path)
                    raise ScenarioError(f"{origin}: {place}{shown(key)}: a key must be text")
            return {str(key): copy(inner, (*path, key)) for key, inner in value.items()}
        if isinstance(value, list | tuple):
            return [copy(inner, (*path, str(index))) for index, inner in enumerate(value)]
        return value

    copied: dict[str, Any] = copy(fields, ())
    return copied


def _merge(
    base: Mapping[str, Any], changes: Mapping[str, Any], path: tuple[str, ...] = ()
) -> dict[str, Any]:
    merged = dict(base)
    for key, value in changes.items():
        place = (*path, key)
        below = merged.get(key)
        if isinstance(value, Mapping) and isinstance(below, Mapping) and place not in _WHOLE:
            merged[key] = _merge(below, value, place)
        else:
            merged[key] = value
    return merged
