"""Multi-agent lane changes in interactive highway traffic.

The names below are imported on first use, so ``import marl_lanes`` is fast and does not import
torch.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from marl_lanes.starting import uncollected

if TYPE_CHECKING:
    __version__: str
    from marl_lanes.envs.batched import LaneChangeEnv
    from marl_lanes.envs.forms import env, parallel_env
    from marl_lanes.naf.loss import NAFLoss
    from marl_lanes.naf.network import NAFNetwork
    from marl_lanes.scenario import Scenario, ScenarioError, list_scenarios, load_scenario
    from marl_lanes.traffic.roles.external import (
        FOLLOWER_COLUMNS,
        FollowerError,
        FollowerPolicy,
        register_follower,
    )
    from marl_lanes.traffic.simulator import Simulator

_HOME_OF = {
    "FOLLOWER_COLUMNS": "marl_lanes.traffic.roles.external",
    "FollowerError": "marl_lanes.traffic.roles.external",
    "FollowerPolicy": "marl_lanes.traffic.roles.external",
    "LaneChangeEnv": "marl_lanes.envs.batched",
    "NAFLoss": "marl_lanes.naf.loss",
    "NAFNetwork": "marl_lanes.naf.network",
    "Scenario": "marl_lanes.scenario",
    "ScenarioError": "marl_lanes.scenario",
    "Simulator": "marl_lanes.traffic.simulator",
    "env": "marl_lanes.envs.forms",
    "list_scenarios": "marl_lanes.scenario",
    "load_scenario": "marl_lanes.scenario",
    "parallel_env": "marl_lanes.envs.forms",
    "register_follower": "marl_lanes.traffic.roles.external",
}

__all__ = [
    "FOLLOWER_COLUMNS",
    "FollowerError",
    "FollowerPolicy",
    "LaneChangeEnv",
    "NAFLoss",
    "NAFNetwork",
    "Scenario",
    "ScenarioError",
    "Simulator",
    "env",
    "list_scenarios",
    "load_scenario",
    "parallel_env",
    "register_follower",
]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return import_module("importlib.metadata").version("marl-lanes")
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    with uncollected():
        value = getattr(import_module(_HOME_OF[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
