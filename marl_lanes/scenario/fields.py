"""Types of a scenario's fields: numbers with limits, speeds with units, ranges, shares."""

import re
from collections.abc import Mapping
from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, WithJsonSchema

_SPEED = re.compile(r"\s*([-+]?\d+(?:\.\d*)?)\s*(km/h|m/s)\s*")
_SPEED_SCHEMA = {
    "anyOf": [
        {"type": "number", "minimum": 0.1, "maximum": 70.0},
        {"type": "string", "pattern": f"^{_SPEED.pattern}$"},
    ]
}
# Control characters, ends of lines, and halves of characters.
_CONTROL = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]")
_TO_METRES_PER_SECOND = {"km/h": 1.0 / 3.6, "m/s": 1.0}


def _parse_speed(value: Any) -> Any:
    """Convert ``"30 km/h"`` or ``"8 m/s"`` to metres per second; return other values unchanged."""
    if not isinstance(value, str):
        return value
    match = _SPEED.fullmatch(value)
    if match is None:
        raise ValueError("a speed must be a number in m/s or a string such as '30 km/h'")
    return float(match[1]) * _TO_METRES_PER_SECOND[match[2]]


def _parse_pair(value: Any) -> Any:
    """Accept a list, as YAML has it, for a pair."""
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise ValueError("must be a list of two numbers")
    return tuple(value)


def _has_no_control(text: str) -> str:
    if _CONTROL.search(text):
        raise ValueError("must have no control characters")
    return text


def _is_ascending(pair: tuple[float, float]) -> tuple[float, float]:
    if pair[0] > pair[1]:
        raise ValueError("the first number must not be above the second")
    return pair


Line = Annotated[str, AfterValidator(_has_no_control)]
Name = Annotated[Line, Field(min_length=1, max_length=255)]

Number = TypeVar("Number")

Real = Annotated[float, Field(strict=True)]
Positive = Annotated[float, Field(strict=True, gt=0.0)]
NonNegative = Annotated[float, Field(strict=True, ge=0.0)]
Share = Annotated[float, Field(strict=True, ge=0.0, le=1e6)]
Count = Annotated[int, Field(strict=True)]
Weight = Annotated[float, Field(strict=True, ge=0.0, le=1e6)]
Speed = Annotated[
    float,
    Field(strict=True, ge=0.1, le=70.0),
    BeforeValidator(_parse_speed),
    WithJsonSchema(_SPEED_SCHEMA),
]
Length = Annotated[float, Field(strict=True, ge=2.0, le=20.0)]
Width = Annotated[float, Field(strict=True, ge=0.5, le=2.6)]
Interval = Annotated[float, Field(strict=True, ge=0.1, le=1e6)]
Position = Annotated[float, Field(strict=True, ge=0.0, le=100_000.0)]
WarmUp = Annotated[float, Field(strict=True, ge=0.0, le=3600.0)]
Range = Annotated[
    tuple[Number, Number], BeforeValidator(_parse_pair), AfterValidator(_is_ascending)
]


def has_weight(mix: Mapping[Any, float]) -> Mapping[Any, float]:
    """Reject a mix whose shares are all 0."""
    if not sum(mix.values()) > 0.0:
        raise ValueError("the shares must sum to more than 0")
    return mix


class Section(BaseModel):
    """A section of the scenario; it rejects unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
