"""Trajectories as Parquet files: one row for each vehicle and time step."""

import textwrap
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from marl_lanes.extras import need
from marl_lanes.files import open_regular, replacing
from marl_lanes.memory import check_memory
from marl_lanes.scenario import Scenario
from marl_lanes.scenario.messages import shown
from marl_lanes.traffic.machine.state import NONE
from marl_lanes.trajectory.checksum import Checksum
from marl_lanes.trajectory.columns import COLUMNS, READ, ROW, Column, new_rows, set_bodies
from marl_lanes.trajectory.frames import Frame, Rows
from marl_lanes.trajectory.metadata import Metadata, TrajectoryError
from marl_lanes.trajectory.road_line import MARGIN

if TYPE_CHECKING:
    import pyarrow

METADATA_KEY = b"marl_lanes"
"""Key of the metadata, JSON, among the file's key-value pairs."""

SUM_KEY = b"marl_lanes.sha256"
"""Key of the checksum of the metadata and of all rows, beside it."""

LARGEST = 1e7
"""Magnitude of the largest number that is read; the times of the longest episodes are below it."""

_TIME_ERROR = 1e-6
"""[s] By which a time may differ from its step's."""

_ROWS_PER_GROUP = 200_000

_BYTES_PER_ROW = 4 * ROW.itemsize
"""While it is read: as Arrow's table, as rows, and as ordered rows."""


@dataclass(frozen=True)
class Trajectory:
    """Recorded roads.

    Args:
        metadata: what it is of.
        rows: (N,) ROW, ordered by road, step and vehicle.
    """

    metadata: Metadata
    rows: Rows

    @property
    def scenario(self) -> Scenario:
        """The scenario of its roads."""
        return self.metadata.scenario

    @property
    def roads(self) -> list[int]:
        """Indices of its roads, ascending."""
        return [int(road) for road in np.unique(self.rows["road"])]

    def rows_of(self, road: int) -> Rows:
        """The rows of one road, a view.

        Raises:
            TrajectoryError: it has no such road.
        """
        start, stop = np.searchsorted(self.rows["road"], [road, road + 1]).tolist()
        if start == stop:
            raise TrajectoryError(f"road = {road}: must be one of {self.roads}")
        return self.rows[start:stop]

    def frames(self, road: int) -> Iterator[Frame]:
        """The frames of one road, one for each step that has a vehicle.

        Raises:
            TrajectoryError: it has no such road.
        """
        rows = self.rows_of(road)
        steps, starts = np.unique(rows["step"], return_index=True)
        stops = [*starts.tolist()[1:], rows.size]
        for step, start, stop in zip(steps.tolist(), starts.tolist(), stops, strict=True):
            yield Frame(self.scenario, road, step, rows[start:stop])


def make_trajectory(metadata: Metadata, blocks: list[Rows]) -> Trajectory:
    """A trajectory of blocks of rows in any order."""
    rows = np.concatenate(blocks) if blocks else new_rows(0)
    return Trajectory(metadata, rows[np.lexsort((rows["vehicle"], rows["step"], rows["road"]))])


class TrajectoryWriter:
    """Writes rows to a Parquet file while they are recorded; a context manager.

    The file is there only once all is written. The rows of a step may be those of many roads.

    Args:
        path: of the file.
        metadata: what it is of.

    Raises:
        MissingExtraError: pyarrow is not installed.
        OSError: the file cannot be written.
    """

    def __init__(self, path: Path, metadata: Metadata) -> None:
        self._arrow = need("pyarrow", "view")
        self._parquet = need("pyarrow.parquet", "view")
        self.path = path
        self.metadata = metadata
        self._blocks: list[Rows] = []
        self._num_waiting = 0
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        temporary = self._stack.enter_context(replacing(self.path))
        try:
            self._schema = make_schema(self.metadata)
            self._checksum = Checksum(self._schema.metadata[METADATA_KEY])
            reals = [column.name for column in COLUMNS if column.kind.startswith("f")]
            others = [column.name for column in COLUMNS if not column.kind.startswith("f")]
            self._file = self._stack.enter_context(
                self._parquet.ParquetWriter(
                    temporary,
                    self._schema,
                    compression="zstd",
                    use_dictionary=others,
                    use_byte_stream_split=reals,
                )
            )
        except BaseException as error:
            self._stack.__exit__(type(error), error, error.__traceback__)
            raise
        return self

    def __exit__(self, *error: Any) -> None:
        if error[0] is None:
            try:
                self._flush()
                self._file.add_key_value_metadata({SUM_KEY: self._checksum.finish()})
            except BaseException as failure:
                self._stack.__exit__(type(failure), failure, failure.__traceback__)
                raise
        self._stack.__exit__(*error)

    def write(self, rows: Rows) -> None:
        """Add the rows of a step."""
        self._blocks.append(rows)
        self._num_waiting += rows.size
        if self._num_waiting >= _ROWS_PER_GROUP:
            self._flush()

    def _flush(self) -> None:
        if self._blocks:
            rows = make_trajectory(self.metadata, self._blocks).rows
            self._blocks, self._num_waiting = [], 0
            self._file.write_table(make_table(self.metadata, rows))
            self._checksum.add(rows)


def write_trajectory(path: Path, trajectory: Trajectory) -> None:
    """Write a Parquet file.

    Raises:
        MissingExtraError: pyarrow is not installed.
        OSError: the file cannot be written.
    """
    with TrajectoryWriter(path, trajectory.metadata) as writer:
        writer.write(trajectory.rows)


def read_trajectory(path: Path) -> Trajectory:
    """Read a Parquet file.

    Raises:
        TrajectoryError: it cannot be read, is no trajectory of this form, or has changed since it
            was written.
        MissingExtraError: pyarrow is not installed.
    """
    arrow, parquet = need("pyarrow", "view"), need("pyarrow.parquet", "view")
    try:
        opened = open_regular(path)
    except OSError as error:
        raise TrajectoryError(f"trajectory {path}: cannot be read: {error.strerror}") from None
    with opened as file:
        try:
            content = parquet.ParquetFile(file)
            num_rows = content.metadata.num_rows
            check_memory(f"{path}: its number of rows", num_rows, num_rows * _BYTES_PER_ROW)
            table = content.read(columns=[column.name for column in READ])
        # pyarrow says OSError and others of damaged content, too.
        except (arrow.ArrowException, OSError, MemoryError, ValueError) as error:
            reason = textwrap.shorten(str(error), 200)
            raise TrajectoryError(f"{path}: not readable as Parquet: {reason}") from None
    found = table.schema.metadata or {}
    text = found.get(METADATA_KEY)
    if text is None:
        raise TrajectoryError(f"{path}: has no metadata {METADATA_KEY.decode()!r}: no trajectory")
    try:
        metadata = Metadata.loads(text)
        rows = _read_rows(table, metadata.scenario)
        checksum = Checksum(text)
        checksum.add(rows)
        trajectory = make_trajectory(metadata, [rows])
        _check_once(trajectory.rows)
    except TrajectoryError as error:
        raise TrajectoryError(f"{path}: {error}") from None
    if checksum.finish() != found.get(SUM_KEY):
        raise TrajectoryError(
            f"{path}: its checksum is wrong: it has changed since it was recorded"
        )
    return trajectory


def make_schema(metadata: Metadata) -> "pyarrow.Schema":
    """The columns with units and meanings, and the metadata."""
    arrow = need("pyarrow", "view")
    fields = [
        arrow.field(
            column.name,
            _kind_of(column),
            nullable=column.is_optional,
            metadata={"unit": column.unit, "meaning": column.meaning},
        )
        for column in COLUMNS
    ]
    return arrow.schema(fields, metadata={METADATA_KEY: metadata.dumps()})


def make_table(metadata: Metadata, rows: Rows) -> "pyarrow.Table":
    """The rows as an Arrow table, names in place of codes, nulls in place of missing values."""
    arrow = need("pyarrow", "view")
    schema = make_schema(metadata)
    arrays = []
    for column, field in zip(COLUMNS, schema, strict=True):
        values = np.ascontiguousarray(rows[column.name])
        if column.names is not None:
            names = arrow.array(column.names(metadata.scenario), arrow.string())
            arrays.append(arrow.DictionaryArray.from_arrays(arrow.array(values), names))
            continue
        mask = None
        if column.is_optional:
            mask = np.isnan(values) if column.kind.startswith("f") else values == NONE
        arrays.append(arrow.array(values, field.type, mask=mask))
    return arrow.Table.from_arrays(arrays, schema=schema)


def _kind_of(column: Column) -> Any:
    arrow = need("pyarrow", "view")
    kind = arrow.from_numpy_dtype(np.dtype(column.kind))
    return kind if column.names is None else arrow.dictionary(kind, arrow.string())


def _read_rows(table: "pyarrow.Table", scenario: Scenario) -> Rows:
    rows = new_rows(table.num_rows)
    for column in READ:
        if column.name not in table.column_names:
            raise TrajectoryError(f"column {column.name}: must be there")
        rows[column.name] = _read_column(table.column(column.name), column, scenario)
    set_bodies(rows, scenario)
    for column in READ:
        values = rows[column.name]
        if column.kind.startswith("f"):
            # nan is a missing value.
            allowed = np.abs(values) <= LARGEST
            if column.is_optional:
                allowed |= np.isnan(values)
            if not allowed.all():
                raise TrajectoryError(
                    f"column {column.name}: {values[~allowed][0]}: must be within {LARGEST:g}"
                )
    if (rows["road"] < 0).any() or (rows["vehicle"] < 0).any():
        raise TrajectoryError("columns road and vehicle: must be at least 0")
    start, end = -MARGIN, scenario.road.length + MARGIN
    is_beyond = (rows["position"] < start) | (rows["position"] > end)
    if is_beyond.any():
        found = rows["position"][is_beyond][0]
        raise TrajectoryError(f"column position: {found}: must be on the road, {start} to {end} m")
    times = rows["step"] * scenario.time_step
    is_wrong = np.abs(rows["time"] - times) > _TIME_ERROR
    if is_wrong.any():
        found, wanted = rows["time"][is_wrong][0], times[is_wrong][0]
        raise TrajectoryError(
            f"column time: {found}: must be {wanted}, the step times {scenario.time_step} s"
        )
    return rows


def _check_once(rows: Rows) -> None:
    """Refuse ordered rows of which two are of one vehicle at one time step."""
    names = ("road", "step", "vehicle")
    is_again = np.logical_and.reduce([rows[name][1:] == rows[name][:-1] for name in names])
    if is_again.any():
        row = rows[1:][is_again][0]
        place = ", ".join(f"{name} = {row[name]}" for name in names)
        raise TrajectoryError(f"{place}: must have one row")


def _read_column(values: Any, column: Column, scenario: Scenario) -> Any:
    """The column as numbers: codes for names, -1 or nan where a value is missing."""
    arrow, compute = need("pyarrow", "view"), need("pyarrow.compute", "view")
    if values.null_count and not column.is_optional:
        raise TrajectoryError(f"column {column.name}: no value may be missing")
    try:
        if column.names is not None:
            names = arrow.array(column.names(scenario), arrow.string())
            codes = compute.index_in(values.cast(arrow.string()), names)
            if codes.null_count:
                strange = values.filter(compute.is_null(codes))[0]
                allowed = ", ".join(column.names(scenario))
                raise TrajectoryError(
                    f"column {column.name}: {shown(strange.as_py())}: must be one of {allowed}"
                )
            return codes.to_numpy()
        kind = arrow.from_numpy_dtype(ROW[column.name])
        missing = float("nan") if column.kind.startswith("f") else NONE
        return values.cast(kind).fill_null(missing).to_numpy()
    except (arrow.ArrowException, ValueError) as error:
        if isinstance(error, TrajectoryError):
            raise
        reason = " ".join(str(error).split())
        raise TrajectoryError(f"column {column.name}: {reason}") from None
