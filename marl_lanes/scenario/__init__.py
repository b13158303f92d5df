"""The scenario: everything that defines a road, its traffic, the commands and the reward.

The names below are imported on first use: the command line shows its help without them.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from marl_lanes.scenario.loading import ScenarioError, list_scenarios, load_scenario
    from marl_lanes.scenario.schema import Scenario

_HOME_OF = {
    "Scenario": "marl_lanes.scenario.schema",
    "ScenarioError": "marl_lanes.scenario.loading",
    "list_scenarios": "marl_lanes.scenario.loading",
    "load_scenario": "marl_lanes.scenario.loading",
}

__all__ = ["Scenario", "ScenarioError", "list_scenarios", "load_scenario"]


def __getattr__(name: str) -> Any:
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(_HOME_OF[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
