"""The part of a road that a film shows: a maneuver, from shortly before it to shortly after it."""

from collections.abc import Sequence
from dataclasses import dataclass

from marl_lanes.traffic.machine.state import Outcome
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


def find_excerpt(
    roads: Sequence[Rows], time_step: float, command: int | None = None
) -> Excerpt | None:
    """The time in which the roads show the maneuver.

    It begins ``LEAD_TIME`` before the vehicle first engages on one of the roads and ends
    ``FOLLOW_UP_TIME`` after the last outcome. Without a command it is that of the first completed
    change of the first road, from its last engagement: the soonest lane change to be seen.

    Args:
        roads: rows of the same road under several policies, at least one.
        time_step: of the scenario [s].
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
    present = [one for one in found if one is not None]
    if not present:
        numbers = ", ".join(map(str, commands[0])) or "none"
        raise TrajectoryError(f"maneuver = {command}: must be a command of the road: {numbers}")
    first = min(_engagement(one, is_last=is_chosen) for one in present)
    last = max(one.last_step for one in present)
    return Excerpt(
        command,
        tuple(None if one is None else one.vehicle for one in found),
        max(0.0, first * time_step - LEAD_TIME),
        last * time_step + FOLLOW_UP_TIME,
    )


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
