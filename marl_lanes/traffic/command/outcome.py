"""How a command ends."""

import math
from typing import Any

from marl_lanes.traffic.machine.compiled import internal
from marl_lanes.traffic.machine.state import Fate, Outcome, Phase

_ENGAGED = int(Phase.ENGAGED)
_LEAVES = int(Fate.LEAVES)
_COLLIDES = int(Fate.COLLIDES)
_STRAYS = int(Fate.STRAYS)
_UNFINISHED = int(Outcome.UNFINISHED)
_COMPLETED = int(Outcome.COMPLETED)
_COLLISION = int(Outcome.COLLISION)
_OFF_ROAD = int(Outcome.OFF_ROAD)
_MISSED = int(Outcome.MISSED)
_HORIZON = int(Outcome.HORIZON)
_TIMED_OUT = int(Outcome.TIMED_OUT)


@internal
def has_arrived(deviation: float, car: Any, turning: float, constants: Any) -> bool:
    """Whether the completion criterion holds: every bound that the scenario sets."""
    return bool(
        abs(deviation) <= constants.completion_max_deviation
        and abs(car.speed * math.sin(car.yaw)) <= constants.completion_max_lateral_speed
        and abs(turning) <= constants.completion_max_yaw_rate
    )


@internal
def find_outcome(
    agent: Any, car: Any, deviation: float, turning: float, road: Any, constants: Any
) -> int:
    """Outcome of the command in this step, UNFINISHED if it goes on."""
    if car.fate == _COLLIDES:
        return _COLLISION
    if car.fate == _STRAYS:
        return _OFF_ROAD
    if agent.phase == _ENGAGED and has_arrived(deviation, car, turning, constants):
        return _COMPLETED
    if car.fate == _LEAVES:
        return _MISSED
    if 0 < constants.time_limit_steps <= road.step - agent.born_step:
        return _TIMED_OUT
    if road.step == constants.horizon_steps > 0:
        return _HORIZON
    return _UNFINISHED
