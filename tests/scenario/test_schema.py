"""The whole scenario: defaults, units of every field, and fields that must fit each other."""

import re

import numpy as np
import pytest
from pydantic import BaseModel
from scenario.drawing import draw_fields, numbers
from scenario.refusals import assert_refused, error_of

from marl_lanes.scenario import followers as followers_module
from marl_lanes.scenario import load_scenario
from marl_lanes.scenario import schema as schema_module

WRONG = [
    ({"time_step": 0.0}, ["time_step = 0.0: must be greater than"]),
    ({"time_step": -0.1}, ["time_step = -0.1: must be greater than"]),
    ({"horizon": 0.0}, ["horizon = 0.0: must be greater than or equal to 0.01"]),
    ({"command": {"position": [140.0, 1200.0]}}, ["command.position = [140.0, 1200.0]", "1000.0"]),
    ({"command": {"lanes": [0, 3]}}, ["command.lanes = [3] must be from 0 to 2, as", "= 3"]),
    ({"command": {"lanes": [-1]}}, ["command.lanes = [-1] must be from 0 to 2, as", "= 3"]),
    ({"command": {"lanes": [1, 1]}}, ["command.lanes", "1, 1"]),
    ({"command": {"probability": 1.5}}, ["command.probability = 1.5: must be less than or equal"]),
    ({"command": {"lanes": []}}, ["command.probability = 0.333", "must be 0, as command.lanes"]),
    ({"command": {"time_limit": 0.05}}, ["command.time_limit = 0.05 must be at least time_step"]),
    ({"command": {"time_limit": 1e7}}, ["command.time_limit = 10000000.0: must be less than or"]),
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


UNLIMITED = {"command.lanes[]": "must be among the road's lanes, at most 16"}
"""Numbers without limits of their own, and why."""


def test_every_number_has_a_lower_and_an_upper_limit():
    found = list(numbers())
    assert len(found) > 70
    missing = {path for path, low, high in found if low is None or high is None}
    assert missing == set(UNLIMITED)
    assert all(-1e9 <= low < high <= 1e9 for path, low, high in found if path not in missing)


@pytest.mark.parametrize("value", [1e308, -1e308])
@pytest.mark.parametrize(
    ("path", "entry"),
    [
        (path.removesuffix("[]"), "[]" in path)
        for path in dict.fromkeys(path for path, *_ in numbers())
        if "arcs" not in path and "*" not in path and path not in UNLIMITED
    ],
)
def test_no_number_may_be_huge(path, entry, value):
    overrides = [value, value] if entry else value
    for name in reversed(path.split(".")):
        overrides = {name: overrides}
    assert path.rpartition(".")[2] in error_of("paper", overrides)


@pytest.mark.parametrize("corner", [0, 1])
def test_all_fields_may_be_at_one_end_of_their_limits(corner):
    fields = draw_fields(np.random.default_rng(corner), corner)
    load_scenario({**fields, "road": {**fields["road"], "arcs": []}})
