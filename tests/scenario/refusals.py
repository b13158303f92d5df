"""What a scenario that is refused says."""

import pytest

from marl_lanes.scenario import ScenarioError, load_scenario


def error_of(source="paper", overrides=None):
    """The message about a scenario that is refused."""
    with pytest.raises(ScenarioError) as caught:
        load_scenario(source, overrides)
    return str(caught.value)


def assert_refused(overrides, parts):
    """Assert that one line names the scenario, and has every part."""
    message = error_of("paper", overrides)
    assert message.startswith("scenario 'paper': ")
    assert "\n" not in message
    for part in parts:
        assert part in message
