"""Garbage collection while much is loaded."""

import gc

import pytest

from marl_lanes.starting import uncollected


@pytest.mark.parametrize("is_enabled", [True, False])
def test_collection_pauses_and_is_as_it_was_afterwards(is_enabled):
    was_enabled = gc.isenabled()
    try:
        (gc.enable if is_enabled else gc.disable)()
        with uncollected():
            assert not gc.isenabled()
        assert gc.isenabled() is is_enabled
        with pytest.raises(KeyError), uncollected():
            {}["an import that fails"]
        assert gc.isenabled() is is_enabled
    finally:
        (gc.enable if was_enabled else gc.disable)()
