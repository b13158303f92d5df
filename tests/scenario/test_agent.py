"""The agent's action and observation: what is refused, and the features' names."""

import pytest
from scenario.refusals import assert_refused, error_of

from marl_lanes.scenario import load_scenario
from marl_lanes.traffic.roles.changer import FEATURES

WRONG = [
    (
        {"action": {"longitudinal": {"max_speed": 0.0}}},
        ["longitudinal.max_speed = 0.0", "than or equal to 0.1"],
    ),
    ({"observation": {"features": []}}, ["observation.features", "at least 1"]),
    ({"observation": {"features": ["sped"]}}, ["observation.features.0 = 'sped'", "'speed'"]),
    ({"observation": {"features": ["yaw", "yaw"]}}, ["observation.features", "['yaw']", "once"]),
]


@pytest.mark.parametrize(("overrides", "parts"), WRONG, ids=[str(row[0]) for row in WRONG])
def test_what_cannot_be_is_refused_with_field_value_and_what_is_allowed(overrides, parts):
    assert_refused(overrides, parts)


def test_the_schema_names_every_feature_of_the_traffic():
    every = [feature.name for feature in FEATURES]
    scenario = load_scenario("paper", {"observation": {"features": every}})
    assert list(scenario.observation.features) == every


def test_the_gaps_stay_within_the_bounds_of_their_feature():
    gap = next(feature for feature in FEATURES if feature.name == "leader_gap")
    load_scenario("paper", {"observation": {"sensor_range": gap.high}})
    message = error_of("paper", {"observation": {"sensor_range": 1.01 * gap.high}})
    assert "observation.sensor_range" in message
