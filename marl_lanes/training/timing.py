"""Where the time of a training goes: for each collected live transition, by activity."""

import time
from collections.abc import Mapping
from typing import Any

from tensordict import TensorDictBase
from tensordict.nn import TensorDictSequential

ACTIVITIES = {
    "simulate": "seconds_simulating",
    "act": "seconds_acting",
    "store": "seconds_storing",
    "learn": "seconds_learning",
    "wait": "seconds_waiting",
}
"""What a training is for, and the counters of it; it waits for workers, or for roads on a GPU."""

OTHER = "other"
"""The rest: the collector's own work, logging, the progress bar."""

Split = dict[str, tuple[float, float]]
"""By activity: microseconds for each transition, and the share of their sum."""


class TimedPolicy(TensorDictSequential):
    """Policies one after the other, and the seconds that they took.

    Attributes:
        seconds: wall time in them so far, in this process.
    """

    seconds = 0.0

    def forward(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        """Write every group's action."""
        start = time.perf_counter()
        result: TensorDictBase = super().forward(tensordict, **kwargs)
        self.seconds += time.perf_counter() - start
        return result


def split_time(seconds: Mapping[str, float], transitions: int) -> Split:
    """The time of a training, its evaluations and what it saved left out, by activity.

    Args:
        seconds: those of ACTIVITIES and, of all of it, seconds_training.
        transitions: that were collected in it, >= 1.

    Returns:
        ACTIVITIES and OTHER, the rest of the whole time.
    """
    total = seconds["seconds_training"]
    parts = {name: seconds.get(key, 0.0) for name, key in ACTIVITIES.items()}
    parts[OTHER] = total - sum(parts.values())
    return {name: (value / transitions * 1e6, value / total) for name, value in parts.items()}


def format_split(split: Split) -> str:
    """The split as a table, its sum in the last row."""
    rows = {**split, "sum": tuple(map(sum, zip(*split.values(), strict=True)))}
    lines = [f"{'':10} {'us / transition':>16} {'share':>7}"]
    lines += [f"{name:10} {one:16.2f} {share:7.1%}" for name, (one, share) in rows.items()]
    return "\n".join(lines)
