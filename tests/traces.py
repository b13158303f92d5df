"""Recorded maneuvers made by hand, for tests."""

import numpy as np

from marl_lanes.evaluation.aftermath import Aftermath
from marl_lanes.evaluation.rollout import TRACE, Maneuver
from marl_lanes.traffic.machine.state import Outcome, Phase

_SIDES = ("leader", "follower", "origin_leader", "origin_follower")


def trace(count, **columns):
    """Rows at 20 m/s without other vehicles, except for ``columns``."""
    rows = np.zeros(count, TRACE)
    rows["step"] = np.arange(1, count + 1)
    rows["phase"] = Phase.ENGAGED
    rows["speed"] = rows["speed_before"] = 20.0
    rows["direction"] = 1
    rows["length"] = rows["leader_length"] = 4.8
    rows["deviation_before"] = 3.75
    for side in _SIDES:
        rows[f"{side}_gap"], rows[f"{side}_speed"] = np.inf, np.nan
    rows["follower_gap_before"] = np.inf
    rows["follower_acceleration"] = rows["imposed_on_follower"] = np.nan
    for name, values in columns.items():
        rows[name] = values
    return rows


def maneuver(rows, outcome=Outcome.MISSED, **changes):
    """A command with these rows; if completed it stays in its lane, except for ``changes``."""
    is_completed = outcome == Outcome.COMPLETED
    values = {
        "env": 0,
        "command": 0,
        "vehicle": 7,
        "outcome": outcome,
        "num_aborts": 0,
        "born_step": 0,
        "waiting_time": 1.5,
        "time_to_end": 9.0,
        "has_side_collision": False,
        "episode_reward": -4.5,
        "trace": rows,
        "aftermath": Aftermath(0.125, watched_time=10.0) if is_completed else None,
    }
    return Maneuver(**(values | changes))
