"""The checksum of a trajectory: of its content, whatever the blocks."""

import numpy as np

from marl_lanes.trajectory.checksum import Checksum
from marl_lanes.trajectory.columns import READ, new_rows


def checksum(*blocks, metadata=b"{}"):
    whole = Checksum(metadata)
    for block in blocks:
        whole.add(block)
    return whole.finish()


def test_it_is_that_of_the_rows_in_whatever_blocks():
    rows = new_rows(5)
    rows["position"] = np.arange(5)
    assert checksum(rows) == checksum(rows[:2], rows[2:])
    assert checksum(rows) != checksum(rows[2:], rows[:2])
    assert len(checksum(rows)) == 64


def test_every_value_and_the_metadata_count():
    rows = new_rows(3)
    found = {checksum(rows), checksum(rows, metadata=b"{ }")}
    for column in READ:
        other = rows.copy()
        other[column.name][1] = 5
        found.add(checksum(other))
    assert len(found) == 2 + len(READ)


def test_every_nan_is_a_missing_value():
    rows, other = new_rows(1), new_rows(1)
    rows["reward"] = np.nan
    other["reward"] = np.uint32(0xFFC00001).view("f4")
    assert checksum(rows) == checksum(other)
