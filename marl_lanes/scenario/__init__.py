"""The scenario: everything that defines a road, its traffic, the commands and the reward."""

from marl_lanes.scenario.loading import ScenarioError, list_scenarios, load_scenario
from marl_lanes.scenario.schema import Scenario

__all__ = ["Scenario", "ScenarioError", "list_scenarios", "load_scenario"]
