"""The drivers' profiles and their mix."""

import pytest
from scenario.refusals import assert_refused

from marl_lanes.scenario import load_scenario

WRONG = [
    ({"drivers": {"mix": {"normal": -1.0}}}, ["drivers.mix.normal = -1.0", "or equal to 0"]),
    ({"drivers": {"mix": {"sporty": 1.0}}}, ["drivers.mix", "sporty", "aggressive", "normal"]),
    ({"drivers": {"car_following": "min"}}, ["car_following = 'min'", "'max', 'sum' or 'acc'"]),
]


@pytest.mark.parametrize(("overrides", "parts"), WRONG, ids=[str(row[0]) for row in WRONG])
def test_what_cannot_be_is_refused_with_field_value_and_what_is_allowed(overrides, parts):
    assert_refused(overrides, parts)


def test_a_new_profile_beside_the_others():
    late = {"minimum_gap": 4.0, "time_headway": 2.0}
    drivers = {"profiles": {"late": late}, "mix": {"late": 1.0, "normal": 1.0}}
    scenario = load_scenario("paper", {"drivers": drivers})
    assert set(scenario.drivers.profiles) == {"normal", "aggressive", "defensive", "late"}
