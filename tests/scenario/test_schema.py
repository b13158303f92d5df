"""The whole scenario: defaults, units of every field, and fields that must fit each other."""

import re

import pytest
from pydantic import BaseModel
from scenario.refusals import assert_refused, error_of

from marl_lanes.scenario import followers as followers_module
from marl_lanes.scenario import load_scenario
from marl_lanes.scenario import schema as schema_module

WRONG = [
    ({"time_step": 0.0}, ["time_step = 0.0: must be greater than"]),
    ({"time_step": -0.1}, ["time_step = -0.1: must be greater than"]),
    ({"horizon": 0.0}, ["horizon = 0.0: must be greater than 0"]),
    ({"command": {"position": [140.0, 1200.0]}}, ["command.position = [140.0, 1200.0]", "1000.0"]),
    ({"command": {"lanes": [0]}}, ["command.lanes = [0] must be among the middle lanes [1]"]),
    ({"command": {"lanes": [2]}}, ["command.lanes = [2] must be among the middle lanes [1]"]),
    ({"command": {"lanes": [-1]}}, ["command.lanes = [-1] must be among the middle lanes [1]"]),
    ({"command": {"lanes": [1, 1]}}, ["command.lanes", "1, 1"]),
    ({"command": {"probability": 1.5}}, ["command.probability = 1.5: must be less than or equal"]),
    ({"road": {"num_lanes": 2}}, ["command.probability", "must be 0", "road.num_lanes = 2"]),
    ({"vehicle": {"width": 2.5}, "road": {"lane_width": 2.5}}, ["vehicle.width = 2.5", "2.5"]),
    ({"completion": {"max_deviation": 1.9}}, ["completion.max_deviation = 1.9", "3.75"]),
]


@pytest.mark.parametrize(("overrides", "parts"), WRONG, ids=[str(row[0]) for row in WRONG])
def test_what_cannot_be_is_refused_with_field_value_and_what_is_allowed(overrides, parts):
    assert_refused(overrides, parts)


UNITS = {"m", "m/s or 'x km/h'", "m/s", "m/s^2", "rad/s", "rad/s^2", "s", "1", "count", "section"}
UNITS |= {"text", "map", "list", "name", "1/(rad/s^2)", "1/(rad/s)"}
UNITS |= {"1/s", "s^2/m", "s^4/m^2", "bool", "path"}


def sections():
    """Every model of the schema."""
    named = {**vars(followers_module), **vars(schema_module)}
    found = [value for value in named.values() if isinstance(value, type)]
    return [value for value in found if issubclass(value, BaseModel) and value is not BaseModel]


def fields():
    return [
        pytest.param(field, id=f"{section.__name__}.{name}")
        for section in sections()
        for name, field in section.model_fields.items()
    ]


def test_the_defaults_are_the_papers_numbers():
    paper = load_scenario()
    assert paper.name == "paper"
    assert (paper.road.length, paper.road.num_lanes, paper.road.lane_width) == (1000.0, 3, 3.75)
    assert paper.time_step == 0.1
    normal = paper.drivers.profiles["normal"]
    assert (normal.minimum_gap, normal.time_headway, normal.exponent) == (5.0, 1.0, 4.0)
    assert (normal.max_acceleration, normal.comfortable_braking) == (2.0, 1.5)
    assert paper.departures.interval == (5.0, 10.0)
    assert paper.departures.initial_speed == pytest.approx((30.0 / 3.6, 50.0 / 3.6))
    assert paper.departures.desired_speed == pytest.approx((80.0 / 3.6, 120.0 / 3.6))
    assert paper.command.probability == pytest.approx(1.0 / 3.0)
    reward = paper.reward
    weights = (reward.yaw_acceleration_weight, reward.yaw_rate_weight, reward.deviation_weight)
    assert weights == (2.0, 0.5, 0.05)
    assert reward.average_deviation == paper.road.lane_width / 2.0


@pytest.mark.parametrize("field", fields())
def test_every_field_says_what_it_is_and_its_unit(field):
    unit = re.search(r"\[([^\]]+)\]", field.description or "")
    assert unit, field.description
    assert unit[1] in UNITS or unit[1].startswith("list of"), unit[1]


@pytest.mark.parametrize("horizon", [0.01, 1e300])
def test_a_horizon_that_cannot_be_counted_in_steps_is_refused(horizon):
    """Rounded to 0 steps a horizon would mean no end; beyond 64 bits it cannot be stored."""
    assert "horizon" in error_of("paper", {"horizon": horizon})
