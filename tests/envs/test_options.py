"""The options of a reset: known ones, and all others."""

import pytest

from marl_lanes import parallel_env
from marl_lanes.envs.options import read_options


def test_the_known_ones_are_read():
    assert read_options(None) == read_options({}) == (None, None)
    assert read_options({"overrides": {"horizon": 9.0}}) == ({"horizon": 9.0}, None)
    assert read_options({"snapshot": b"1"}).snapshot == b"1"


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        ({"densty": 3.0}, r"options\['densty'\]: must be one of \('overrides', 'snapshot'\)"),
        ({1: 2}, r"options\[1\]: must be one of"),
        ({"options": 2}, r"options\['options'\]: must be one of"),
        ([], r"options = \[\]: must be a mapping"),
        ({"overrides": 3}, r"options\['overrides'\] = 3: must be of type Mapping"),
        ({"snapshot": "x"}, r"options\['snapshot'\] = 'x': must be of type bytes"),
    ],
)
def test_others_are_refused_and_nothing_has_changed(options, problem):
    road = parallel_env(seed=0)
    before = road.simulator.snapshot()
    with pytest.raises(ValueError, match=f"^{problem}[^\n]*$"):
        road.reset(seed=1, options=options)
    assert road.simulator.snapshot() == before
