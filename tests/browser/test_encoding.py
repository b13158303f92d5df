"""The form that the page reads, decoded again by its description."""

import base64
import gzip
import json

import numpy as np
import pytest
from recordings import record

from marl_lanes import load_scenario
from marl_lanes.browser.encoding import ENCODED, QUANTA, encode_chunk, encode_header
from marl_lanes.trajectory.columns import COLUMNS, new_rows
from marl_lanes.trajectory.events import Event, find_events
from marl_lanes.trajectory.metadata import Metadata, TrajectoryError
from marl_lanes.trajectory.road_line import RoadLine


def decode(header, chunk):
    """The columns of a chunk by name, written from the module's description alone."""
    data = gzip.decompress(base64.b64decode(chunk["data"]))
    count, offset, found = chunk["num_rows"], 0, {}
    for column, width in zip(header["columns"], chunk["widths"], strict=True):
        zigzag = np.zeros(count, np.int64)
        for plane in range(width):
            zigzag |= np.frombuffer(data, np.uint8, count, offset).astype(np.int64) << (8 * plane)
            offset += count
        codes = np.cumsum(np.where(zigzag % 2, -(zigzag + 1) // 2, zigzag // 2))
        if column["quantum"] is None:
            found[column["name"]] = codes
        elif column["is_optional"]:
            codes = np.where(codes > 0, codes - 1, np.where(codes == 0, np.nan, codes))
            found[column["name"]] = codes * column["quantum"]
        else:
            found[column["name"]] = codes * column["quantum"]
    assert offset == len(data)
    return found


@pytest.fixture(scope="module")
def trajectory():
    return record("interactive", 150, num_envs=2)


def test_every_value_comes_back(trajectory):
    rows = trajectory.rows_of(1)
    header = json.loads(json.dumps(encode_header(trajectory.metadata, 1)))
    chunk = json.loads(json.dumps(encode_chunk(rows, find_events(rows))))
    found = decode(header, chunk)
    rows = rows[np.lexsort((rows["step"], rows["vehicle"]))]
    missing = {column.name for column in COLUMNS} - set(found)
    assert missing == {"road", "time", "length", "width"}
    bodies = [header["bodies"][code] for code in found["profile"]]
    for name in ("length", "width"):
        assert [body[name] for body in bodies] == rows[name].tolist()
    assert np.isnan(rows["reward"]).any()
    assert np.isfinite(rows["reward"]).any()
    for column in ENCODED:
        values = rows[column.name]
        if column.kind.startswith("f"):
            error = np.abs(found[column.name] - values)
            assert np.array_equal(np.isnan(error), np.isnan(values)), column.name
            # Single precision holds large rewards only to a few digits less than a quantum.
            assert np.nanmax(error, initial=0.0) <= 0.5001 * QUANTA[column.unit], column.name
        else:
            assert np.array_equal(found[column.name], values), column.name


def test_names_and_units_are_those_of_the_trajectory(trajectory):
    header = encode_header(trajectory.metadata, 0)
    by_name = {column.name: column for column in COLUMNS}
    for column in header["columns"]:
        assert column["unit"] == by_name[column["name"]].unit
        names = by_name[column["name"]].names
        expected = None if names is None else list(names(trajectory.scenario))
        assert column["names"] == expected
    assert header["scenario"] == "interactive"
    assert header["time_step"] == trajectory.scenario.time_step


def test_chunks_of_later_steps_hold_the_same_rows(trajectory):
    rows = trajectory.rows_of(0)
    header = encode_header(trajectory.metadata, 0)
    whole = decode(header, encode_chunk(rows, []))
    chunks = [
        encode_chunk(part, []) for part in (rows[rows["step"] <= 70], rows[rows["step"] > 70])
    ]
    assert [(one["first_step"], one["last_step"]) for one in chunks] == [(0, 70), (71, 150)]
    parts = [decode(header, chunk) for chunk in chunks]
    joined = {name: np.concatenate([part[name] for part in parts]) for name in whole}
    order = np.lexsort((joined["step"], joined["vehicle"]))
    for name, values in whole.items():
        assert np.array_equal(joined[name][order], values, equal_nan=True), name


def test_events_are_listed(trajectory):
    rows = trajectory.rows_of(0)
    events = [Event(3, "collision", 7, None, 8), Event(5, "completed", 9, 2, None)]
    chunk = encode_chunk(rows, events)
    assert chunk["events"] == [[3, "collision", 7, None, 8], [5, "completed", 9, 2, None]]


def test_the_same_rows_in_any_order_give_the_same_bytes(trajectory):
    rows = trajectory.rows_of(0)
    mixed = np.random.default_rng(0).permutation(rows)
    assert encode_chunk(rows, []) == encode_chunk(mixed, [])


@pytest.mark.parametrize("name", ["curved", "paper"])
def test_the_line_is_that_of_the_road(name):
    scenario = load_scenario(name)
    sent = encode_header(Metadata(scenario, 0, "x"), 0)["line"]
    line = RoadLine(scenario)
    for coordinate in ("x", "y"):
        between = np.interp(line.position, sent["position"], sent[coordinate])
        assert np.abs(between - getattr(line, coordinate)).max() < 0.005
    assert len(sent["x"]) < (2000 if name == "curved" else 5)


@pytest.mark.parametrize("value", [np.inf, 1e9])
def test_a_value_that_does_not_fit_is_refused(value):
    rows = new_rows(2)
    rows["acceleration"] = value
    with pytest.raises(TrajectoryError, match=r"column acceleration: .* must be finite and within"):
        encode_chunk(rows, [])


def test_a_value_must_not_be_missing_where_none_may():
    rows = new_rows(1)
    rows["acceleration"] = np.nan
    with pytest.raises(TrajectoryError, match="column acceleration: nan"):
        encode_chunk(rows, [])
