"""One road's trajectory as the page reads it: a header, and chunks of rows.

Header and chunks are JSON. A file holds all steps in one chunk; a live stream sends the header once
and then chunks of later steps, which the page appends to the same store.

The header is ``{format, scenario, description, policy, seed, version, road, time_step, num_lanes,
lane_width, road_length, bodies, max_braking, brake_light, line, columns}``. ``bodies`` lists the
``{length, width}`` of a vehicle by its code of ``profile``.
``line`` has arrays ``position``, ``x``, ``y``, ``heading``: points of the road's right edge; the
page interpolates between them. ``columns`` lists ``{name, type, unit, meaning, quantum,
is_optional, names}``, as in ``trajectory/columns.py``; ``quantum`` is null for whole numbers.
``seed`` is a text, because JavaScript rounds large numbers.

A chunk is ``{first_step, last_step, num_rows, widths, data, events}``. Its rows are those of the
steps from the first to the last, ordered by vehicle, then step: a vehicle's rows are contiguous.
``events`` lists ``[step, kind, vehicle, command, other]``, as in ``trajectory/events.py``.
``data`` is base64 of gzip of the columns, one after the other. A column becomes bytes so:

1. codes: a whole number is its own code, with -1 where it is missing. A real number v has
   q = round(v/quantum); if it is optional, its code is q for q < 0, q + 1 for q >= 0, and 0 where
   it is missing.
2. differences: each code minus that of the row before, the first one minus 0.
3. zigzag: 0, -1, 1, -2, ... become 0, 1, 2, 3, ...
4. planes: ``widths`` has the column's bytes per value (1, 2 or 4); first the lowest byte of every
   row, then the next byte of every row.
"""

import base64
import gzip
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from marl_lanes.trajectory.columns import READ, Column
from marl_lanes.trajectory.events import Event
from marl_lanes.trajectory.frames import Rows
from marl_lanes.trajectory.metadata import Metadata, TrajectoryError
from marl_lanes.trajectory.road_line import RoadLine
from marl_lanes.trajectory.signals import BRAKE_LIGHT

FORMAT = 2
"""Number of the form above."""

QUANTA = {
    "m": 1e-3,
    "m/s": 1e-3,
    "m/s^2": 1e-3,
    "rad": 1e-5,
    "rad/s": 1e-5,
    "rad/s^2": 1e-5,
    "1": 1e-5,
}
"""Steps in which real numbers are kept, by unit; all are finer than what one can see."""

ENCODED: tuple[Column, ...] = tuple(
    column for column in READ if column.name not in ("road", "time")
)
"""The columns of a chunk. The road is one, and the time is the step times the time step."""

_MAX_CODE = 2**30 - 1
"""Differences of larger codes would not fit into 4 bytes."""

_LINE_ERROR = 2e-3
"""[m] How far the road's line, between the points that are sent, is off that with all points."""


def encode_header(metadata: Metadata, road: int) -> dict[str, Any]:
    """The header of one road.

    Args:
        metadata: of the trajectory.
        road: index of the road.
    """
    scenario = metadata.scenario
    return {
        "format": FORMAT,
        "scenario": scenario.name,
        "description": scenario.description,
        "policy": metadata.policy,
        "seed": str(metadata.seed),
        "version": metadata.version,
        "road": road,
        "time_step": scenario.time_step,
        "num_lanes": scenario.road.num_lanes,
        "lane_width": scenario.road.lane_width,
        "road_length": scenario.road.length,
        "bodies": [
            dict(zip(("length", "width"), scenario.body_of(name), strict=True))
            for name in scenario.drivers.profiles
        ],
        "max_braking": scenario.vehicle.max_braking,
        "brake_light": BRAKE_LIGHT,
        "line": _encode_line(RoadLine(scenario)),
        "columns": [
            {
                "name": column.name,
                "type": column.kind,
                "unit": column.unit,
                "meaning": column.meaning,
                "quantum": _quantum(column),
                "is_optional": column.is_optional,
                "names": None if column.names is None else list(column.names(scenario)),
            }
            for column in ENCODED
        ],
    }


def encode_chunk(rows: Rows, events: Iterable[Event]) -> dict[str, Any]:
    """The chunk of some steps of one road.

    Args:
        rows: (N,) ROW of one road, all rows of each step, in any order; N >= 1.
        events: of these steps, ordered by step.

    Raises:
        TrajectoryError: a value is too large for the form, or not finite.
    """
    rows = rows[np.lexsort((rows["step"], rows["vehicle"]))]
    widths, planes = [], []
    for column in ENCODED:
        codes = _encode_values(rows[column.name], column)
        differences = np.diff(codes, prepend=np.int64(0))
        zigzag = ((differences << 1) ^ (differences >> 63)).astype("<u4")
        width = _width(int(zigzag.max(initial=0)))
        widths.append(width)
        planes.append(zigzag.view(np.uint8).reshape(-1, 4)[:, :width].T.tobytes())
    packed = gzip.compress(b"".join(planes), 6, mtime=0)
    return {
        "first_step": int(rows["step"].min()),
        "last_step": int(rows["step"].max()),
        "num_rows": int(rows.size),
        "widths": widths,
        "data": base64.b64encode(packed).decode("ascii"),
        "events": [list(event) for event in events],
    }


def _quantum(column: Column) -> float | None:
    return QUANTA[column.unit] if column.kind.startswith("f") else None


def _encode_values(values: NDArray[Any], column: Column) -> NDArray[np.int64]:
    quantum = _quantum(column)
    if quantum is None:
        return np.asarray(values, np.int64)
    reals = np.asarray(values, np.float64)
    is_missing = np.isnan(reals) if column.is_optional else np.zeros(reals.shape, np.bool_)
    scaled = np.rint(np.where(is_missing, 0.0, reals) / quantum)
    is_wrong = ~(np.abs(scaled) < _MAX_CODE)
    if is_wrong.any():
        limit = _MAX_CODE * quantum
        raise TrajectoryError(
            f"column {column.name}: {reals[is_wrong][0]}: must be finite and within {limit:g} "
            f"{column.unit} for the page"
        )
    codes = scaled.astype(np.int64)
    if column.is_optional:
        codes = np.where(is_missing, 0, codes + (codes >= 0))
    return codes


def _width(largest: int) -> int:
    return 1 if largest < 1 << 8 else 2 if largest < 1 << 16 else 4


def _encode_line(line: RoadLine) -> dict[str, list[float]]:
    """The points of the line that are needed, closer together where it bends."""
    kept = [0]
    last = line.position.size - 1
    positions, headings = line.position.tolist(), line.heading.tolist()
    low, high = sorted(headings[:2])
    for index in range(1, last):
        # A chord of length l on an arc that turns by b is l b/8 off.
        length = positions[index + 1] - positions[kept[-1]]
        # From the turning within the chord, so that a bend to and fro counts.
        low, high = min(low, headings[index + 1]), max(high, headings[index + 1])
        if length * (high - low) / 8.0 > _LINE_ERROR:
            kept.append(index)
            low, high = sorted(headings[index : index + 2])
    kept.append(last)
    return {
        "position": np.round(line.position[kept], 3).tolist(),
        "x": np.round(line.x[kept], 3).tolist(),
        "y": np.round(line.y[kept], 3).tolist(),
        "heading": np.round(line.heading[kept], 6).tolist(),
    }
