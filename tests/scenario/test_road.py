"""The road and its arcs: what is refused."""

import pytest
from scenario.refusals import assert_refused

WRONG = [
    ({"road": {"num_lanes": 1}}, ["road.num_lanes = 1: must be greater than or equal to 2"]),
]
ARCS = [
    ([{"start": 10.0, "end": 5.0, "radius": 500.0}], ["start 10.0", "end 5.0"]),
    ([{"start": 10.0, "end": 5000.0, "radius": 500.0}], ["end 5000.0", "length = 1000.0"]),
    ([{"start": 10.0, "end": 50.0, "radius": 10.0}], ["|radius| = 10.0", "50 m"]),
    ([{"start": 10.0, "end": 50.0, "radius": 0.0}], ["|radius| = 0.0", "50 m"]),
    (
        [{"start": 10.0, "end": 50.0, "radius": 90.0, "transition": 21.0}],
        ["transition = 21.0 of the arc from 10.0 to 50.0 must be at most half", "20.0"],
    ),
    (
        [{"start": 10.0, "end": 50.0, "radius": 90.0, "transition": -1.0}],
        ["transition = -1.0", "greater than or equal to 0"],
    ),
    (
        [
            {"start": 10.0, "end": 50.0, "radius": 500.0, "transition": 5.0},
            {"start": 40.0, "end": 60.0, "radius": 500.0, "transition": 5.0},
        ],
        ["starts at 40.0", "ends at 50.0"],
    ),
]
WRONG += [({"road": {"arcs": arcs}}, parts) for arcs, parts in ARCS]


@pytest.mark.parametrize(("overrides", "parts"), WRONG, ids=[str(row[0]) for row in WRONG])
def test_what_cannot_be_is_refused_with_field_value_and_what_is_allowed(overrides, parts):
    assert_refused(overrides, parts)
