"""The drivers' profiles and their mix."""

import pytest
from scenario.refusals import assert_refused

from marl_lanes.scenario import ScenarioError, load_scenario

WRONG = [
    ({"drivers": {"mix": {"normal": -1.0}}}, ["drivers.mix.normal = -1.0", "or equal to 0"]),
    ({"drivers": {"mix": {"sporty": 1.0}}}, ["drivers.mix", "sporty", "aggressive", "normal"]),
    ({"drivers": {"profiles": {"truck": {"length": 20.1}}}}, ["truck.length = 20.1", "20"]),
    ({"drivers": {"profiles": {"truck": {"width": 0.4}}}}, ["truck.width = 0.4", "0.5"]),
    ({"drivers": {"profiles": {"truck": {"desired_speed": [30.0, 20.0]}}}}, ["must not be above"]),
    ({"drivers": {"car_following": "min"}}, ["car_following = 'min'", "'max', 'sum' or 'acc'"]),
]


@pytest.mark.parametrize(("overrides", "parts"), WRONG, ids=[str(row[0]) for row in WRONG])
def test_what_cannot_be_is_refused_with_field_value_and_what_is_allowed(overrides, parts):
    assert_refused(overrides, parts)


def test_a_new_profile_beside_the_others():
    late = {"minimum_gap": 4.0, "time_headway": 2.0}
    drivers = {"profiles": {"late": late}, "mix": {"late": 1.0, "normal": 1.0}}
    scenario = load_scenario("paper", {"drivers": drivers})
    assert set(scenario.drivers.profiles) == {"normal", "aggressive", "defensive", "truck", "late"}


NARROW = {"road": {"lane_width": 2.55}, "completion": {"max_deviation": 0.2}}


def test_who_drives_must_fit_into_a_lane():
    assert load_scenario("paper", NARROW)
    overrides = NARROW | {"drivers": {"mix": {"normal": 0.9, "truck": 0.1}}}
    message = r"drivers\.profiles\.truck\.width = 2\.55 must be below road\.lane_width = 2\.55"
    with pytest.raises(ScenarioError, match=message):
        load_scenario("paper", overrides)


SLOW = {"comfortable_lateral_acceleration": 4.0, "desired_speed": [20.0, 25.0]}


@pytest.mark.parametrize(
    ("own", "is_accepted"), [({}, True), ({"width": 2.6}, False), ({"desired_speed": None}, False)]
)
def test_a_wide_or_fast_vehicle_needs_a_gentler_curve(own, is_accepted):
    """The room beside the body and the top speed are those of the profile."""
    overrides = {
        "road": {"arcs": [{"start": 100.0, "end": 400.0, "radius": 700.0, "transition": 0.0}]},
        "lane_keeping": {"pole": 1.0},
        "drivers": {"profiles": {"bus": SLOW | own}, "mix": {"bus": 1.0}},
    }
    if is_accepted:
        assert load_scenario("paper", overrides)
    else:
        with pytest.raises(ScenarioError, match="with the driver profile 'bus'"):
            load_scenario("paper", overrides)


def test_one_line_puts_trucks_on_the_road():
    trucks = load_scenario("paper", {"drivers": {"mix": {"normal": 0.8, "truck": 0.2}}})
    assert trucks.body_of("truck") == (16.5, 2.55)
    assert trucks.body_of("normal") == (4.8, 1.8)
    assert trucks.desired_speed_of("truck") == pytest.approx((80.0 / 3.6, 90.0 / 3.6))
    shipped = load_scenario("trucks")
    assert shipped.drivers == trucks.drivers
