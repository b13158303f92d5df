"""The followers' dispositions, with and without a policy."""

import pytest
from scenario.refusals import assert_refused

from marl_lanes.scenario import ScenarioError, load_scenario
from marl_lanes.traffic.simulator import Simulator

WRONG = [
    ({"followers": {"mix": {"very rude": 1.0}}}, ["followers.mix.very rude"]),
    ({"followers": {"mix": {"rude": -1.0}}}, ["followers.mix.rude = -1.0", "or equal to 0"]),
]


@pytest.mark.parametrize(("overrides", "parts"), WRONG, ids=[str(row[0]) for row in WRONG])
def test_what_cannot_be_is_refused_with_field_value_and_what_is_allowed(overrides, parts):
    assert_refused(overrides, parts)


@pytest.mark.parametrize("name", ["rude", "learned"])
def test_a_disposition_without_a_policy_is_refused_when_the_traffic_is_built(name):
    scenario = load_scenario("paper", {"followers": {"mix": {"neutral": 1.0, name: 1.0}}})
    assert scenario.followers.external_names == (name,)
    with pytest.raises(ScenarioError) as caught:
        Simulator(scenario)
    for part in ("scenario 'paper'", f"followers.mix: '{name}' has no policy", "cooperative"):
        assert part in str(caught.value)
    Simulator(scenario, follower_policies={name: lambda seen: 0.0 * seen[:, 0]}, seed=0)
