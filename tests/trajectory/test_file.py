import json
import os

import numpy as np
import pandas
import polars
import pyarrow
import pyarrow.parquet
import pytest
import recordings
from damage import assert_read_as_it_was_or_refused
from systems import needs

from marl_lanes import load_scenario
from marl_lanes.trajectory.columns import COLUMNS
from marl_lanes.trajectory.file import (
    METADATA_KEY,
    TrajectoryWriter,
    make_trajectory,
    read_trajectory,
    write_trajectory,
)
from marl_lanes.trajectory.metadata import Metadata, TrajectoryError


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("trajectories") / "interactive.parquet"
    write_trajectory(path, recordings.interactive())
    return path


def changed(file, tmp_path, change):
    """A copy of the file with another table."""
    path = tmp_path / "changed.parquet"
    # Other readers of pyarrow leave out the checksum.
    table = pyarrow.parquet.ParquetFile(file).read()
    pyarrow.parquet.write_table(change(table), path)
    return path


def replaced(table, name, values):
    index = table.column_names.index(name)
    return table.set_column(index, pyarrow.field(name, values.type), values)


def test_what_is_written_is_read(file):
    written, read = recordings.interactive(), read_trajectory(file)
    assert read.metadata == written.metadata
    assert read.rows.tobytes() == written.rows.tobytes()


def test_equal_trajectories_are_equal_files(file, tmp_path):
    write_trajectory(tmp_path / "again.parquet", recordings.interactive())
    assert (tmp_path / "again.parquet").read_bytes() == file.read_bytes()


def test_writing_in_pieces_gives_the_same_rows(tmp_path, monkeypatch):
    monkeypatch.setattr("marl_lanes.trajectory.file._ROWS_PER_GROUP", 1000)
    trajectory = recordings.interactive()
    with TrajectoryWriter(tmp_path / "pieces.parquet", trajectory.metadata) as writer:
        for frame in trajectory.frames(0):
            writer.write(frame.rows)
    assert pyarrow.parquet.ParquetFile(tmp_path / "pieces.parquet").num_row_groups > 5
    assert read_trajectory(tmp_path / "pieces.parquet").rows.tobytes() == trajectory.rows.tobytes()


def test_an_interrupted_recording_leaves_what_was_there(tmp_path):
    path = tmp_path / "kept.parquet"
    path.write_bytes(b"before")
    trajectory = recordings.paper()

    def record():
        with TrajectoryWriter(path, trajectory.metadata) as writer:
            writer.write(trajectory.rows)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record()
    assert path.read_bytes() == b"before"
    assert [entry.name for entry in tmp_path.iterdir()] == ["kept.parquet"]


def test_pandas_and_polars_read_it_in_one_line(file):
    rows = recordings.interactive().rows
    for table in (pandas.read_parquet(file), polars.read_parquet(file)):
        assert table.shape == (rows.size, len(COLUMNS))
        assert list(table["speed"]) == rows["speed"].tolist()
        engaged = sum(phase == "engaged" for phase in table["phase"])
        assert engaged == (rows["phase"] == 2).sum() > 50
    table = pandas.read_parquet(file)
    assert table["command"].isna().sum() == (rows["command"] == -1).sum()


def test_the_file_says_units_meanings_and_what_it_is_of(file):
    schema = pyarrow.parquet.read_schema(file)
    assert schema.field("speed").metadata[b"unit"] == b"m/s"
    assert b"heading" in schema.field("yaw").metadata[b"meaning"]
    found = json.loads(schema.metadata[METADATA_KEY])
    assert (found["seed"], found["policy"], found["format"]) == (0, "tuned-cascade", 2)
    assert load_scenario(found["scenario"]) == load_scenario("interactive")


def test_frames_are_the_rows_of_each_step(file):
    trajectory = read_trajectory(file)
    frames = list(trajectory.frames(0))
    assert [frame.step for frame in frames] == list(range(501))
    assert np.concatenate([frame.rows for frame in frames]).tobytes() == trajectory.rows.tobytes()
    with pytest.raises(TrajectoryError, match=r"road = 5: must be one of \[0\]"):
        trajectory.rows_of(5)


def test_an_empty_recording_can_be_kept(tmp_path):
    empty = make_trajectory(Metadata(load_scenario("paper"), 0, "none"), [])
    write_trajectory(tmp_path / "empty.parquet", empty)
    assert read_trajectory(tmp_path / "empty.parquet").roads == []


def test_a_file_that_is_not_there_is_named(tmp_path):
    # The rest is the system's.
    with pytest.raises(TrajectoryError, match=r"trajectory .*none\.parquet: cannot be read: \w"):
        read_trajectory(tmp_path / "none.parquet")


def test_no_parquet_is_refused(tmp_path):
    path = tmp_path / "text.parquet"
    path.write_text("no table", encoding="utf-8")
    with pytest.raises(TrajectoryError, match=r"text.parquet: not readable as Parquet"):
        read_trajectory(path)


def test_a_damaged_file_is_refused(file, tmp_path):
    content = file.read_bytes()
    (tmp_path / "cut.parquet").write_bytes(content[: len(content) // 2])
    with pytest.raises(TrajectoryError, match="not readable as Parquet"):
        read_trajectory(tmp_path / "cut.parquet")


def test_a_file_with_a_damaged_part_is_refused(file, tmp_path):
    content = bytearray(file.read_bytes())
    content[4 : len(content) // 2] = bytes(len(content) // 2 - 4)
    (tmp_path / "damaged.parquet").write_bytes(content)
    with pytest.raises(TrajectoryError, match=r"damaged\.parquet: not readable as Parquet"):
        read_trajectory(tmp_path / "damaged.parquet")


def test_a_file_with_a_flipped_bit_is_refused_or_reads_the_same(tmp_path):
    recorded = recordings.paper()
    rows = recorded.rows[recorded.rows["step"] < 5]
    write_trajectory(tmp_path / "t.parquet", make_trajectory(recorded.metadata, [rows]))

    def plain(path):
        found = read_trajectory(path)
        return found.metadata, found.rows.tobytes()

    path = tmp_path / "t.parquet"
    assert assert_read_as_it_was_or_refused(path, plain, TrajectoryError) > 100


def test_other_rows_than_those_recorded_are_refused(file, tmp_path):
    def slower(table):
        rows = table["speed"].to_numpy().copy()
        rows[7] = np.nextafter(rows[7], np.float32(0))
        return replaced(table, "speed", pyarrow.array(rows))

    with pytest.raises(TrajectoryError, match=r"changed\.parquet: its checksum is wrong"):
        read_trajectory(changed(file, tmp_path, slower))
    with pytest.raises(TrajectoryError, match="its checksum is wrong"):
        read_trajectory(changed(file, tmp_path, lambda table: table.slice(0, 100)))
    with pytest.raises(TrajectoryError, match="its checksum is wrong"):
        read_trajectory(
            changed(
                file,
                tmp_path,
                lambda table: table.replace_schema_metadata(
                    {
                        key: value
                        for key, value in table.schema.metadata.items()
                        if b"sha" not in key
                    }
                ),
            )
        )
    # What is written again unchanged is the same trajectory.
    assert read_trajectory(changed(file, tmp_path, lambda table: table)).roads == [0]


@needs("mkfifo")
def test_what_is_no_file_is_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe.parquet")
    for path in (tmp_path / "pipe.parquet", tmp_path):
        with pytest.raises(TrajectoryError, match="cannot be read"):
            read_trajectory(path)


def test_a_number_of_rows_beyond_the_memory_is_refused(file, monkeypatch):
    monkeypatch.setattr("marl_lanes.trajectory.file._BYTES_PER_ROW", 1e12)
    with pytest.raises(TrajectoryError, match=r"number of rows = .*GiB of memory"):
        read_trajectory(file)


def test_a_table_of_something_else_is_refused(tmp_path):
    path = tmp_path / "other.parquet"
    pyarrow.parquet.write_table(pyarrow.table({"speed": [1.0]}), path)
    with pytest.raises(TrajectoryError, match=r"no metadata 'marl_lanes'"):
        read_trajectory(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda table: table.drop_columns(["yaw"]), "column yaw: must be there"),
        (
            lambda table: replaced(table, "time", pyarrow.array([7.0] * table.num_rows)),
            r"column time: 7.0: must be 0.0, the step times 0.1 s",
        ),
        (
            lambda table: pyarrow.concat_tables([table, table.slice(3, 1)]),
            "road = 0, step = 0, vehicle = [0-9]+: must have one row",
        ),
        (
            lambda table: replaced(table, "phase", pyarrow.array(["odd"] * table.num_rows)),
            "column phase: 'odd': must be one of absent, waiting",
        ),
        (
            lambda table: replaced(table, "speed", pyarrow.array(["x"] * table.num_rows)),
            "column speed:",
        ),
        (
            lambda table: replaced(table, "speed", pyarrow.array([np.nan] * table.num_rows)),
            "column speed: nan: must be within 1e\\+07",
        ),
        (
            lambda table: replaced(table, "position", pyarrow.array([1e300] * table.num_rows)),
            r"column position: 1e\+300: must be within",
        ),
        (
            lambda table: replaced(table, "reward", pyarrow.array([np.inf] * table.num_rows)),
            "column reward: inf: must be within",
        ),
        (
            lambda table: replaced(table, "position", pyarrow.array([1e6] * table.num_rows)),
            "column position: 1000000.0: must be on the road, -500.0 to ",
        ),
        (
            lambda table: replaced(table, "vehicle", pyarrow.array([-2] * table.num_rows)),
            "columns road and vehicle: must be at least 0",
        ),
        (
            lambda table: replaced(
                table, "vehicle", pyarrow.array([None] * table.num_rows, pyarrow.int32())
            ),
            "column vehicle: no value may be missing",
        ),
        (
            lambda table: replaced(table, "lane", pyarrow.array([10**6] * table.num_rows)),
            "column lane:",
        ),
    ],
)
def test_a_wrong_column_is_named(file, tmp_path, change, message):
    with pytest.raises(TrajectoryError, match=f"changed.parquet: {message}"):
        read_trajectory(changed(file, tmp_path, change))


def test_a_reader_finds_the_size_of_every_vehicle(tmp_path):
    write_trajectory(tmp_path / "trucks.parquet", recordings.record("trucks", 5, seed=2))
    table = pandas.read_parquet(tmp_path / "trucks.parquet")
    sizes = set(zip(table["profile"], table["length"], table["width"], strict=True))
    assert sizes == {("normal", 4.8, 1.8), ("truck", 16.5, 2.55)}


def test_sizes_follow_from_the_profiles_also_where_a_file_lacks_them(file, tmp_path):
    """As the files of 0.2.0 do; and other sizes in a file count for nothing."""
    lacking = changed(file, tmp_path, lambda table: table.drop_columns(["length", "width"]))
    assert read_trajectory(lacking).rows.tobytes() == recordings.interactive().rows.tobytes()
    huge = pyarrow.array(np.full(recordings.interactive().rows.size, 1e9))
    other = changed(file, tmp_path, lambda table: replaced(table, "length", huge))
    assert read_trajectory(other).rows.tobytes() == recordings.interactive().rows.tobytes()
