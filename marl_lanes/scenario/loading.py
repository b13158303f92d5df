"""Scenarios by name, from a YAML file or from a mapping."""

from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml
from pydantic import ValidationError

from marl_lanes.scenario.messages import explain
from marl_lanes.scenario.schema import Scenario


class ScenarioError(ValueError):
    """An invalid scenario: the message names each field, its value and the allowed values."""


if TYPE_CHECKING:
    from yaml import SafeLoader
else:
    # The same loader in C is ten times faster; not every build of PyYAML has it.
    SafeLoader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class _UniqueKeyLoader(SafeLoader):
    """YAML's safe loader, which also rejects duplicate keys."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        keys = [self.construct_object(key, deep=True) for key, _ in node.value]
        for key in keys:
            if keys.count(key) > 1:
                raise ScenarioError(f"key {key!r} is written twice{node.start_mark}")
        return super().construct_mapping(node, deep)


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
    """A scenario by its shipped name, from a YAML file, or from a mapping.

    Args:
        source: a name of ``list_scenarios()``, the path of a YAML file (a ``Path``, or a string
            with a path separator or the suffix ``.yaml`` or ``.yml``), a mapping of fields, or a
            scenario.
        overrides: fields to replace, nested as in the YAML; sections are merged key by key.

    Raises:
        ScenarioError: no such scenario or file, or invalid fields; the message names each field,
            its value and the allowed values.
    """
    if isinstance(source, Scenario):
        if not overrides:
            return source
        data: Any = source.model_dump(mode="json")
        origin = f"scenario {source.name!r}"
    elif isinstance(source, Mapping):
        data = dict(source)
        data.setdefault("name", "custom")
        origin = "scenario from a mapping"
    else:
        text, origin, name = _read(source)
        try:
            data = yaml.load(text, Loader=_UniqueKeyLoader)  # noqa: S506 - a SafeLoader
        except (yaml.YAMLError, ScenarioError) as error:
            raise ScenarioError(f"{origin}: not readable as YAML: {error}") from None
        if not isinstance(data, dict):
            raise ScenarioError(f"{origin}: must be a mapping of fields, got {data!r}")
        data.setdefault("name", name)
    try:
        return Scenario.model_validate(_merge(data, overrides or {}))
    except ValidationError as error:
        raise ScenarioError(f"{origin}: {explain(error, Scenario)}") from None


def _read(source: str | Path) -> tuple[str, str, str]:
    """The text of a scenario file, a description of its source, and the default name."""
    is_path = isinstance(source, Path) or source.endswith((".yaml", ".yml")) or "/" in source
    if is_path:
        path = Path(source)
        try:
            return path.read_text(encoding="utf-8"), f"scenario file {path}", path.stem
        except (OSError, UnicodeDecodeError) as error:
            raise ScenarioError(f"scenario file {path}: cannot be read: {error}") from None
    names = list_scenarios()
    if source not in names:
        raise ScenarioError(
            f"scenario {source!r}: no such scenario; allowed: {', '.join(names)}, or the path of "
            "a .yaml file"
        )
    file = resources.files("marl_lanes.scenarios").joinpath(f"{source}.yaml")
    return file.read_text(encoding="utf-8"), f"scenario {source!r}", str(source)


def _merge(base: Mapping[str, Any], overrides: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in overrides.items():
        below = merged.get(key)
        # A mix is replaced as a whole: its shares are relative to each other.
        if isinstance(value, Mapping) and isinstance(below, Mapping) and key != "mix":
            merged[key] = _merge(below, value)
        else:
            merged[key] = value
    return merged
