"""The scenario in which a training collects."""

import pytest

from marl_lanes import load_scenario
from marl_lanes.training.collected import load_collected
from marl_lanes.training.config import ConfigError

PAPER = load_scenario("paper")


def test_it_is_that_of_the_evaluation_with_overrides():
    found = load_collected(PAPER, {"num_agents": None, "road": {"num_lanes": 5}})
    assert (found.num_agents, found.road.num_lanes) == (None, 5)
    assert found.command == PAPER.command
    assert load_collected(PAPER, {}) == PAPER


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"road": {"num_lanes": 0}}, r"scenario 'paper': road.num_lanes = 0: must be "),
        ({"command": {"probability": 0.0}}, r"command.probability = 0: must be above 0"),
    ],
)
def test_what_does_not_fit_is_named(overrides, message):
    with pytest.raises(ConfigError, match=rf"^training_overrides: {message}"):
        load_collected(PAPER, overrides)
