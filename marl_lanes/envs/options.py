"""What ``reset(options=...)`` of the PettingZoo environment takes."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from marl_lanes.scenario.messages import shown

_OF_PETTINGZOO = {"options": 1}
"""What PettingZoo's own test of a parallel environment gives to see whether they are taken."""


class ResetOptions(NamedTuple):
    """How the next episode differs from others."""

    overrides: Mapping[str, Any] | None = None
    """Fields of the scenario to replace in it."""
    snapshot: bytes | None = None
    """The state in which it begins."""


def read_options(options: object) -> ResetOptions:
    """The options of a reset.

    Args:
        options: None, or a mapping with ``overrides`` or ``snapshot``.

    Raises:
        ValueError: it is something else, or has other names.
    """
    if options is None or options == _OF_PETTINGZOO:
        return ResetOptions()
    if not isinstance(options, Mapping):
        raise ValueError(f"options = {shown(options)}: must be a mapping")
    for name, value in options.items():
        if name not in ResetOptions._fields:
            raise ValueError(f"options[{shown(name)}]: must be one of {ResetOptions._fields}")
        kind = {"overrides": Mapping, "snapshot": bytes}[name]
        if not isinstance(value, kind):
            raise ValueError(f"options[{name!r}] = {shown(value)}: must be of type {kind.__name__}")
    return ResetOptions(**options)
