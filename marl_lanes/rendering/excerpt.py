"""The part of a road that a film shows: a maneuver, from shortly before it to shortly after it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from marl_lanes.traffic.machine.state import Outcome, Phase
from marl_lanes.trajectory.events import Command, find_commands
from marl_lanes.trajectory.frames import Rows
from marl_lanes.trajectory.metadata import TrajectoryError

LEAD_TIME = 2.0
"""[s] Shown before the engagement."""
FOLLOW_UP_TIME = 3.0
"""[s] Shown after the outcome."""


@dataclass(frozen=True)
class Excerpt:
    """A maneuver of a road and of its other versions.

    Args:
        command: k of changer_k.
        vehicles: its vehicle on each road; None where the command is not recorded.
        start: of what is shown [s].
        end: of what is shown [s].
    """

    command: int
    vehicles: tuple[int | None, ...]
    start: float
    end: float


def find_excerpt(roads: Sequence[Rows], command: int | None = None) -> Excerpt | None:
    """The time in which the roads show the maneuver.

    It begins ``LEAD_TIME`` before the vehicle first engages on one of the roads and ends
    ``FOLLOW_UP_TIME`` after the last outcome. Without a command it is that of the first completed
    change of the first road, from its last engagement: the soonest lane change to be seen.

    Args:
        roads: rows of the same road under several policies, at least one.
        command: k of changer_k; None: chosen.

    Returns:
        the excerpt; None if no command is given and the first road has none that engages.

    Raises:
        TrajectoryError: no road has the command.
    """
    commands = [{one.command: one for one in find_commands(rows)} for rows in roads]
    is_chosen = command is None
    if command is None:
        command = _choose(list(commands[0].values()))
        if command is None:
            return None
    found = [known.get(command) for known in commands]
    present = [(rows, one) for rows, one in zip(roads, found, strict=True) if one is not None]
    if not present:
        numbers = ", ".join(map(str, commands[0])) or "none"
        raise TrajectoryError(f"maneuver = {command}: must be a command of the road: {numbers}")
    first = min(_time_of(rows, _engagement(one, is_last=is_chosen)) for rows, one in present)
    last = max(_time_of(rows, one.last_step) for rows, one in present)
    return Excerpt(
        command,
        tuple(None if one is None else one.vehicle for one in found),
        max(0.0, first - LEAD_TIME),
        last + FOLLOW_UP_TIME,
    )


def find_crossing(rows: Rows, excerpt: Excerpt) -> float:
    """When the excerpt's vehicle crosses the marking; the excerpt's middle if it does not [s].

    Args:
        rows: of the excerpt's first road.
        excerpt: found on it.
    """
    own = rows[(rows["vehicle"] == excerpt.vehicles[0]) & (rows["phase"] == Phase.ENGAGED)]
    own = own[own["time"] >= excerpt.start]
    own = own[(own["lane_low"] == np.minimum(own["origin_lane"], own["target_lane"]))]
    own = own[own["lane_high"] == np.maximum(own["origin_lane"], own["target_lane"])]
    if not own.size:
        return 0.5 * (excerpt.start + excerpt.end)
    return float(np.median(own["time"]))


def _choose(commands: Sequence[Command]) -> int | None:
    """The first completed change, else the first command that engages."""
    engaged = [one for one in commands if one.engaged_steps]
    completed = [one for one in engaged if one.outcome == Outcome.COMPLETED]
    if completed:
        return min(completed, key=lambda one: one.last_step).command
    return min(engaged, key=lambda one: one.engaged_steps[0]).command if engaged else None


def _engagement(command: Command, *, is_last: bool) -> int:
    """The step of its first or last engagement; of the command itself if it never engages."""
    steps = command.engaged_steps or (command.first_step,)
    return steps[-1] if is_last else steps[0]


def _time_of(rows: Rows, step: int) -> float:
    return float(rows["time"][rows["step"] == step][0])
