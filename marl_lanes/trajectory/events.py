"""What happens on a recorded road: commands, engagements, aborts, outcomes, losses."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from marl_lanes.traffic.machine.state import NONE, Fate, Outcome, Phase
from marl_lanes.trajectory.frames import Rows

KINDS = (
    "command",
    "engaged",
    "aborted",
    "completed",
    "missed",
    "timed_out",
    "horizon",
    "collision",
    "off_road",
)
"""Kinds of events. ``collision`` and ``off_road`` are also those of vehicles without a command,
for example of one that has completed its change before."""


class Event(NamedTuple):
    """Something that happened to a vehicle in a step."""

    step: int
    kind: str
    vehicle: int
    command: int | None
    """The vehicle's command, also after it has ended; None for a vehicle without one."""
    other: int | None
    """The vehicle that it collided with."""


class Command(NamedTuple):
    """The life of a command, as far as it was recorded."""

    command: int
    vehicle: int
    first_step: int
    """Its first recorded step."""
    engaged_steps: tuple[int, ...]
    """The steps at whose end it engaged; in the next ones it steered."""
    last_step: int
    """Its last recorded step."""
    outcome: Outcome
    """UNFINISHED if the recording ended before."""
    num_aborts: int


def find_events(rows: Rows) -> list[Event]:
    """The events of one road, ordered by step and vehicle.

    What began before the first recorded step is no event.

    Args:
        rows: (N,) ROW of one road, in any order.
    """
    if not rows.size:
        return []
    rows, is_first = _by_vehicle(rows)
    # Of the vehicle's row before; a vehicle's first row has none.
    before = np.maximum(np.arange(rows.size) - 1, 0)
    is_new = ~is_first | (rows["step"] > rows["step"].min())
    command, phase, outcome = rows["command"], rows["phase"], rows["outcome"]
    was_command = np.where(is_first, NONE, command[before])
    was_phase = np.where(is_first, Phase.ABSENT, phase[before])
    begins = is_new & (command != NONE) & (command != was_command)
    found = {
        "command": begins,
        "engaged": is_new & (phase == Phase.ENGAGED) & (was_phase != Phase.ENGAGED),
        "aborted": is_new & (phase == Phase.ABORTING) & (was_phase != Phase.ABORTING),
        "completed": outcome == Outcome.COMPLETED,
        "missed": outcome == Outcome.MISSED,
        "timed_out": outcome == Outcome.TIMED_OUT,
        "horizon": outcome == Outcome.HORIZON,
        "collision": rows["fate"] == Fate.COLLIDES,
        "off_road": rows["fate"] == Fate.STRAYS,
    }
    last = _last_commands(command, is_first)
    events = []
    for rank, kind in enumerate(KINDS):
        for index in np.flatnonzero(found[kind]).tolist():
            row = rows[index]
            own, other = int(last[index]), int(row["collided_with"])
            event = Event(
                step=int(row["step"]),
                kind=kind,
                vehicle=int(row["vehicle"]),
                command=None if own == NONE else own,
                other=None if other == NONE else other,
            )
            events.append((event.step, event.vehicle, rank, event))
    return [event for *_, event in sorted(events, key=lambda entry: entry[:3])]


def find_commands(rows: Rows) -> list[Command]:
    """The commands of one road, ordered by their number.

    Args:
        rows: (N,) ROW of one road, in any order.
    """
    engaged: dict[int, list[int]] = {}
    for event in find_events(rows):
        if event.kind == "engaged" and event.command is not None:
            engaged.setdefault(event.command, []).append(event.step)
    commanded = rows[rows["command"] != NONE]
    if not commanded.size:
        return []
    commanded = commanded[np.lexsort((commanded["step"], commanded["command"]))]
    numbers, starts = np.unique(commanded["command"], return_index=True)
    stops = [*starts.tolist()[1:], commanded.size]
    found = []
    for number, start, stop in zip(numbers.tolist(), starts.tolist(), stops, strict=True):
        first, last = commanded[start], commanded[stop - 1]
        found.append(
            Command(
                command=number,
                vehicle=int(first["vehicle"]),
                first_step=int(first["step"]),
                engaged_steps=tuple(engaged.get(number, ())),
                last_step=int(last["step"]),
                outcome=Outcome(int(last["outcome"])),
                num_aborts=int(last["num_aborts"]),
            )
        )
    return found


def _by_vehicle(rows: Rows) -> tuple[Rows, NDArray[np.bool_]]:
    """The rows ordered by vehicle and step, and which of them are the first of a vehicle."""
    rows = rows[np.lexsort((rows["step"], rows["vehicle"]))]
    is_first = np.ones(rows.size, np.bool_)
    is_first[1:] = rows["vehicle"][1:] != rows["vehicle"][:-1]
    return rows, is_first


def _last_commands(command: NDArray[np.int32], is_first: NDArray[np.bool_]) -> NDArray[np.int32]:
    """For each row the vehicle's command then, or else its last one before; NONE if it had none."""
    marks = np.where((command != NONE) | is_first, np.arange(command.size), 0)
    return np.asarray(command[np.maximum.accumulate(marks)])
