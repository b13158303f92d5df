"""Options of a picture: size, camera, followed vehicle, speed."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

MIN_SIZE = (320, 180)
MAX_SIZE = (3840, 2160)

SPAN = (20.0, 2000.0)
"""[m]"""
SPEED = (0.01, 100.0)
"""[1]"""
_CHANGER = re.compile(r"changer_(0|[1-9][0-9]*)")


@dataclass(frozen=True)
class ViewOptions:
    """How traffic is shown.

    Args:
        size: width and height [pixel], even, 320 x 180 to 3840 x 2160.
        span: length of road that the camera shows [m], 20 to 2000; more where the road would
            else be too wide for the picture.
        follow: a changer ("changer_3"), a vehicle (its number), or None: the picture chooses.
        speed: of playback, relative to real time [1], 0.01 to 100.

    Raises:
        ValueError: a field is not valid; the message says which.
    """

    size: tuple[int, int] = (1280, 720)
    span: float = 140.0
    follow: str | int | None = None
    speed: float = 1.0

    def __post_init__(self) -> None:
        """Reject fields that are not valid."""
        object.__setattr__(self, "size", _check_size(self.size))
        object.__setattr__(self, "span", _check_number("span", self.span, SPAN, " m"))
        object.__setattr__(self, "speed", _check_number("speed", self.speed, SPEED, ""))
        follow = self.follow
        if isinstance(follow, str):
            is_valid = _CHANGER.fullmatch(follow) is not None
        else:
            is_valid = follow is None or (_is_integer(follow) and follow >= 0)
        if not is_valid:
            raise ValueError(
                f"follow = {follow!r}: must be None, a changer such as 'changer_3', "
                "or a vehicle's number"
            )

    @classmethod
    def make(cls, value: "ViewOptions | Mapping[str, Any] | None" = None) -> "ViewOptions":
        """The options themselves, from a mapping of some of the fields, or the defaults.

        Raises:
            ValueError: a name is unknown, or a field is not valid.
        """
        if isinstance(value, cls):
            return value
        if value is None:
            return cls()
        if not isinstance(value, Mapping):
            raise ValueError(f"options = {value!r}: must be ViewOptions, a mapping or None")
        names = [field.name for field in fields(cls)]
        for name in value:
            if name not in names:
                raise ValueError(f"{name}: is no option of a view: {', '.join(names)}")
        return cls(**value)

    @property
    def followed_command(self) -> int | None:
        """K if changer_k is to be followed."""
        if not isinstance(self.follow, str):
            return None
        return int(self.follow.removeprefix("changer_"))


def _is_integer(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _check_size(size: Any) -> tuple[int, int]:
    limits = tuple(zip(MIN_SIZE, MAX_SIZE, strict=True))
    is_pair = isinstance(size, tuple | list) and len(size) == len(limits)
    if not is_pair or not all(
        _is_integer(pixels) and low <= pixels <= high and pixels % 2 == 0
        for pixels, (low, high) in zip(size, limits, strict=True)
    ):
        raise ValueError(
            f"size = {size!r}: must be width and height, even, from {MIN_SIZE[0]} x {MIN_SIZE[1]} "
            f"to {MAX_SIZE[0]} x {MAX_SIZE[1]} pixels"
        )
    return size[0], size[1]


def _check_number(name: str, value: Any, limits: tuple[float, float], unit: str) -> float:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not is_number or not math.isfinite(value) or not limits[0] <= value <= limits[1]:
        raise ValueError(f"{name} = {value!r}: must be {limits[0]:g} to {limits[1]:g}{unit}")
    return float(value)
