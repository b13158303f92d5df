"""The columns of a trajectory: name, type, unit and meaning of each in one place."""

from collections.abc import Callable
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from marl_lanes.scenario import Scenario
from marl_lanes.traffic.machine.state import NONE, Disposition, Fate, Outcome, Phase
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.traffic.roles.follower import FOLLOWER

Names = Callable[[Scenario], tuple[str, ...]]
"""The names that the codes 0, 1, ... of a column stand for."""


class Column(NamedTuple):
    """A column of the table."""

    name: str
    kind: str
    """numpy's type; a column with ``names`` holds codes of them."""
    unit: str
    meaning: str
    is_optional: bool = False
    """Whether a value can be missing: -1 or nan in the rows, null in a file."""
    names: Names | None = None
    is_derived: bool = False
    """Whether it follows from the scenario and another column: a file has it for its readers, but
    it is not read back."""


def _names_of(enumeration: type[IntEnum]) -> Names:
    names = tuple(member.name.lower() for member in enumeration)
    return lambda _: names


def _profiles(scenario: Scenario) -> tuple[str, ...]:
    return tuple(scenario.drivers.profiles)


def _dispositions(scenario: Scenario) -> tuple[str, ...]:
    scripted = (Disposition.COOPERATIVE, Disposition.NEUTRAL, Disposition.ADVERSARIAL)
    names = tuple(disposition.name.lower() for disposition in scripted)
    return names + scenario.followers.external_names


def _terms(prefix: str, role_terms: tuple[str, ...], who: str) -> tuple[Column, ...]:
    return tuple(
        Column(f"{prefix}{name}", "f4", "1", f"{name.removeprefix('reward_')} term of {who}", True)
        for name in role_terms
    )


_PLACE = (
    Column("road", "i4", "1", "index of the road within the seed's roads"),
    Column("step", "i4", "step", "steps since the warm-up ended"),
    Column("time", "f8", "s", "step times dt"),
    Column("vehicle", "i4", "1", "serial number of the vehicle on its road"),
)
_STATE = (
    Column("position", "f8", "m", "of the centre, along the road's right edge"),
    Column("lateral_position", "f4", "m", "of the centre, from the right edge, positive left"),
    Column("speed", "f4", "m/s", "along the vehicle's heading"),
    Column("acceleration", "f4", "m/s^2", "longitudinal, applied in the step"),
    Column("yaw", "f4", "rad", "heading relative to the road, positive left"),
    Column("yaw_rate", "f4", "rad/s", "turning of the heading, the road's own included"),
    Column("yaw_acceleration", "f4", "rad/s^2", "applied in the step"),
    Column("desired_speed", "f4", "m/s", "v0 of the car-following law"),
    Column("lane", "i1", "lane", "the lane that it keeps, 0 is the right-most"),
    Column("lane_low", "i1", "lane", "right-most lane that its body overlaps"),
    Column("lane_high", "i1", "lane", "left-most lane that its body overlaps"),
    Column("moving_over", "i1", "1", "while it moves over for a changer: 1 left, -1 right; else 0"),
    Column("profile", "i1", "name", "profile of the driver", names=_profiles),
    Column("length", "f8", "m", "of the body, by the profile", is_derived=True),
    Column("width", "f8", "m", "of the body, by the profile", is_derived=True),
    Column("disposition", "i1", "name", "what it does behind a changer", names=_dispositions),
    Column("fate", "i1", "name", "what the step did with the vehicle", names=_names_of(Fate)),
    Column("collided_with", "i4", "1", "vehicle that it collided with in the step", True),
    Column("changer", "i4", "1", "vehicle of the engaged changer whose follower it is", True),
)
_CHANGER = (
    Column("command", "i4", "1", "k of changer_k, while its command lives", True),
    Column("phase", "i1", "name", "phase of the command after the step", names=_names_of(Phase)),
    Column("outcome", "i1", "name", "how the command ended in the step", names=_names_of(Outcome)),
    Column("direction", "i1", "1", "1 to the left, -1 to the right, 0 without a command"),
    Column("origin_lane", "i1", "lane", "lane of the command", True),
    Column("target_lane", "i1", "lane", "lane to reach", True),
    Column("num_aborts", "i2", "1", "aborts since the command", True),
    Column("leader", "i4", "1", "vehicle ahead in the origin lane", True),
    Column("follower", "i4", "1", "vehicle behind in the origin lane", True),
    Column("target_leader", "i4", "1", "vehicle ahead in the target lane", True),
    Column("target_follower", "i4", "1", "vehicle behind in the target lane", True),
    Column("lateral_deviation", "f4", "m", "to the reference lane, positive to the target", True),
    Column("action_yaw_acceleration", "f4", "rad/s^2", "the policy's, to the target", True),
    Column("action_acceleration", "f4", "m/s^2", "the policy's second action", True),
    Column("reward", "f4", "1", "of the step: the sum of the terms", True),
    *_terms("", CHANGER.reward_names, "the changer's reward"),
)
_FOLLOWER = (
    Column("follower_action", "f4", "m/s^2", "acceleration by the policy of a follower", True),
    Column("follower_reward", "f4", "1", "of the step: the sum of the terms", True),
    *_terms("follower_", FOLLOWER.reward_names, "the follower's reward"),
)

COLUMNS: tuple[Column, ...] = (*_PLACE, *_STATE, *_CHANGER, *_FOLLOWER)
"""Every column, in the order of a file. The step is that before the row: rewards, actions and
accelerations belong to it, positions and speeds are those after it."""

ROW = np.dtype([(column.name, column.kind) for column in COLUMNS])
"""One vehicle at one time step."""


READ: tuple[Column, ...] = tuple(column for column in COLUMNS if not column.is_derived)
"""The columns that are read from a file."""


def set_bodies(rows: np.ndarray[tuple[int], np.dtype[np.void]], scenario: Scenario) -> None:
    """Set length and width of the (N,) ROW by their profiles."""
    bodies = np.array([scenario.body_of(name) for name in scenario.drivers.profiles])
    rows["length"], rows["width"] = bodies[rows["profile"]].T


def new_rows(count: int) -> np.ndarray[tuple[int], np.dtype[np.void]]:
    """(count,) ROW: optional values missing, the others 0."""
    rows = np.zeros(count, ROW)
    for column in COLUMNS:
        if column.is_optional:
            rows[column.name] = np.nan if column.kind.startswith("f") else NONE
    return rows
