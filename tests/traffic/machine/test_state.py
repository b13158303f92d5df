"""The tables of the state, and their allocation."""

import dataclasses

import numpy as np
import pytest

from marl_lanes.traffic.machine import state as tables
from marl_lanes.traffic.machine.state import (
    NONE,
    NUM_COLLISION_RECORDS,
    Outcome,
    allocate,
    structure,
    truncates,
)


@pytest.mark.parametrize("name", ["VEHICLE", "AGENT", "FOLLOWER", "ROAD", "LANE", "COLLISION"])
def test_every_quantity_of_the_state_has_a_unit_and_a_meaning(name):
    table = getattr(tables, name)
    assert len({row[0] for row in table}) == len(table)
    for field, kind, unit, meaning in table:
        assert field.islower()
        assert np.dtype(kind.removeprefix("(T,)")).itemsize in (4, 8)
        assert unit in {"m", "m/s", "m/s^2", "rad", "rad/s", "rad/s^2", "s", "1", "lane", "step"}
        assert len(meaning) > 3


def test_fields_that_would_need_padding_are_refused():
    mixed = (("small", "i4", "1", "a number"), ("large", "f8", "1", "a number"))
    with pytest.raises(ValueError, match="8-byte fields must come first"):
        structure(mixed)
    with pytest.raises(ValueError, match="number of 4-byte fields must be even"):
        structure(mixed[::-1])
    assert structure((*mixed[::-1], ("other", "u4", "1", "a number"))).itemsize == 16


def test_a_role_has_as_many_terms_as_it_is_given():
    assert structure(tables.AGENT, num_terms=6)["terms"].shape == (6,)
    assert structure(tables.FOLLOWER, num_terms=5)["terms"].shape == (5,)


def test_a_new_state_has_no_vehicle_and_no_agent():
    state = allocate(
        num_envs=2,
        num_lanes=3,
        max_vehicles=7,
        num_slots=4,
        num_features=6,
        num_terms=5,
        num_follower_features=9,
        num_follower_terms=8,
    )
    assert [
        getattr(state, field.name) is array
        for field, array in zip(dataclasses.fields(state), state.arrays, strict=True)
    ] == [True] * 9
    shapes = [(2,), (2, 3), (2, 7), (2, 7), (2, 4), (2, 4), (2, NUM_COLLISION_RECORDS)]
    assert [array.shape for array in state.arrays] == [*shapes, (2, 4, 6), (2, 4, 9)]
    nowhere = {
        "vehicles": ("id", "agent"),
        "agents": ("vehicle", "command"),
        "followers": ("vehicle", "policy"),
        "collisions": ("rear_id", "front_id"),
    }
    for table, names in nowhere.items():
        for name in names:
            assert (getattr(state, table)[name] == NONE).all(), (table, name)
            getattr(state, table)[name] = 0
    # Every other byte is 0.
    assert not any(state.tobytes())


def test_the_road_and_what_limits_time_truncate_and_the_task_does_not():
    assert {outcome for outcome in Outcome if truncates(outcome)} == {
        Outcome.MISSED,
        Outcome.HORIZON,
        Outcome.TIMED_OUT,
    }
