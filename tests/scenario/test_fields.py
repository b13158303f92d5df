"""Types of fields: numbers with limits, speeds with units, ranges, shares."""

import pytest
from scenario.refusals import assert_refused, error_of

from marl_lanes.scenario import load_scenario

WRONG = [
    ({"road": {"num_lanes": "3"}}, ["road.num_lanes = '3': must be a valid integer"]),
    ({"road": {"num_lanes": 2.5}}, ["road.num_lanes = 2.5: must be a valid integer"]),
    ({"road": {"num_lanes": True}}, ["road.num_lanes = True: must be a valid integer"]),
    ({"road": {"length": "long"}}, ["road.length = 'long': must be a valid number"]),
    ({"road": {"length": float("nan")}}, ["road.length = nan: must be a finite number"]),
    ({"road": {"length": float("inf")}}, ["road.length = inf: must be a finite number"]),
    ({"road": 5}, ["road = 5: must be a mapping of length, num_lanes"]),
    ({"warmup": [90.0, 60.0]}, ["warmup = ", "must not be above the second"]),
    ({"warmup": [1.0]}, ["warmup", "1"]),
    ({"followers": {"mix": {"neutral": 0.0}}}, ["followers.mix", "sum to more than 0"]),
    ({"drivers": {"mix": {"normal": 0.0}}}, ["drivers.mix", "sum to more than 0"]),
    ({"departures": {"initial_speed": ["fast", 9.0]}}, ["initial_speed", "'fast'", "'30 km/h'"]),
    ({"departures": {"initial_speed": ["30 mph", 9.0]}}, ["'30 mph'", "'30 km/h'"]),
    (
        {"departures": {"initial_speed": ["0 km/h", 9.0]}},
        ["initial_speed.0 = 0.0", "greater than or equal to 0.1"],
    ),
]


@pytest.mark.parametrize(("overrides", "parts"), WRONG, ids=[str(row[0]) for row in WRONG])
def test_what_cannot_be_is_refused_with_field_value_and_what_is_allowed(overrides, parts):
    assert_refused(overrides, parts)


@pytest.mark.parametrize(
    ("text", "speed"),
    [("36 km/h", 10.0), ("10 m/s", 10.0), ("90.0km/h", 25.0), (" 18 km/h ", 5.0), (12.5, 12.5)],
)
def test_speeds_may_be_written_with_their_unit(text, speed):
    scenario = load_scenario("paper", {"departures": {"initial_speed": [text, "60 m/s"]}})
    assert scenario.departures.initial_speed == pytest.approx((speed, 60.0))


def test_a_scenario_cannot_be_changed():
    scenario = load_scenario("paper")
    with pytest.raises(ValueError, match="frozen"):
        scenario.road.length = 5.0


def test_shares_whose_sum_overflows_are_refused():
    assert "mix" in error_of("paper", {"drivers": {"mix": {"normal": 1e308, "aggressive": 1e308}}})
