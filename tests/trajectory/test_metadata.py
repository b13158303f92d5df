import json

import pytest

from marl_lanes import load_scenario
from marl_lanes.trajectory.metadata import Metadata, TrajectoryError


def fields(**changes):
    found = json.loads(Metadata(load_scenario("curved"), 7, "some policy", "1.2").dumps())
    return json.dumps(found | changes)


def test_it_comes_back():
    scenario = load_scenario("interactive", {"followers": {"mix": {"mine": 1.0}}})
    metadata = Metadata(scenario, 2**63, "runs/paper/checkpoints/final.pt")
    assert Metadata.loads(metadata.dumps()) == metadata


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "not readable as JSON"),
        ("[]", "must be a mapping"),
        (100_000 * "[", "not readable as JSON"),
        (fields(format=99), "format = 99: must be 2"),
        (fields(seed="0"), "seed = '0': must be a whole number"),
        (fields(policy=None), "policy = None: must be a text"),
        (fields(scenario={"name": "x", "road": {"num_lanes": 99}}), r"road.num_lanes = 99"),
    ],
)
def test_other_metadata_is_refused(text, message):
    with pytest.raises(TrajectoryError, match=message):
        Metadata.loads(text)


@pytest.mark.parametrize("name", ["format", "seed", "policy", "scenario"])
def test_a_large_value_is_shown_short(name):
    with pytest.raises(TrajectoryError, match=rf"^metadata: {name} = .{{1,80}}: must be"):
        Metadata.loads(fields(**{name: ["x"] * 10**5}))
