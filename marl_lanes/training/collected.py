"""The scenario in which a training collects: that of the evaluation with ``training_overrides``."""

from collections.abc import Mapping
from typing import Any

from marl_lanes.scenario import Scenario, ScenarioError, load_scenario
from marl_lanes.training.config import ConfigError


def load_collected(evaluated: Scenario, overrides: Mapping[str, Any]) -> Scenario:
    """The scenario with the overrides.

    Args:
        evaluated: the scenario of the evaluation.
        overrides: ``training_overrides``.

    Raises:
        ConfigError: they do not fit it, or nobody would be commanded.
    """
    try:
        scenario = load_scenario(evaluated, overrides)
    except ScenarioError as error:
        raise ConfigError(f"training_overrides: {error}") from None
    if scenario.command.probability == 0.0:
        raise ConfigError("training_overrides: command.probability = 0: must be above 0")
    return scenario
