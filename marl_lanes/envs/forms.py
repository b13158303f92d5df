"""The forms of the PettingZoo environment: parallel or in cycles, and what is wrapped around it."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypedDict, Unpack

import numpy as np
from pettingzoo import AECEnv
from pettingzoo.utils.conversions import parallel_to_aec_wrapper
from pettingzoo.utils.wrappers import OrderEnforcingWrapper

from marl_lanes.envs.closing import Closes
from marl_lanes.envs.normalised import Normalised
from marl_lanes.envs.parallel import LaneChangeParallelEnv
from marl_lanes.envs.population import ConstantPopulation
from marl_lanes.scenario import Scenario
from marl_lanes.scenario.messages import shown
from marl_lanes.traffic.arguments import check_flag
from marl_lanes.traffic.roles.external import FollowerPolicy

if TYPE_CHECKING:
    from marl_lanes.envs.rendering import View

_POPULATIONS = ("live", "constant")


class Options(TypedDict, total=False):
    """The keyword arguments of ``LaneChangeParallelEnv``, which documents them."""

    seed: int | None
    overrides: Mapping[str, Any] | None
    learned_followers: bool
    follower_policies: Mapping[str, FollowerPolicy] | None
    max_cycles: int | None
    has_flat_state: bool
    view: "View"


class FormOptions(Options, total=False):
    """Those of ``parallel_env``, which documents them."""

    population: Literal["live", "constant"]
    normalised: bool


def parallel_env(
    scenario: str | Path | Mapping[str, Any] | Scenario = "paper",
    render_mode: str | None = None,
    *,
    population: Literal["live", "constant"] = "live",
    normalised: bool = False,
    **options: Unpack[Options],
) -> LaneChangeParallelEnv | Normalised | ConstantPopulation:
    """The parallel environment.

    Args:
        scenario: as for ``LaneChangeParallelEnv``.
        render_mode: as for ``LaneChangeParallelEnv``.
        population: "live": ``agents`` and every dict have the live agents alone; "constant": every
            possible agent takes part until the episode's end, as ``ConstantPopulation`` says.
        normalised: observations are a few units at most, and actions from -1 to 1, as
            ``Normalised`` says.
        **options: those of ``LaneChangeParallelEnv``.

    Raises:
        ValueError: ``population`` or ``normalised`` is something else; and all that
            ``LaneChangeParallelEnv`` raises.
    """
    if population not in _POPULATIONS:
        raise ValueError(f"population = {shown(population)}: must be one of {_POPULATIONS}")
    is_normalised = check_flag("normalised", normalised)
    road = LaneChangeParallelEnv(scenario, render_mode, **options)
    wrapped = Normalised(road) if is_normalised else road
    return ConstantPopulation(wrapped) if population == "constant" else wrapped


def env(
    scenario: str | Path | Mapping[str, Any] | Scenario = "paper",
    render_mode: str | None = None,
    **options: Unpack[FormOptions],
) -> AECEnv:
    """The same environment in PettingZoo's AEC (agent-environment-cycle) form."""
    return _CycleEnv(parallel_to_aec_wrapper(parallel_env(scenario, render_mode, **options)))


class _CycleEnv(Closes, OrderEnforcingWrapper[Any, Any, Any]):
    """PettingZoo's conversion, with what the parallel form can do besides."""

    @property
    def np_random(self) -> np.random.Generator:
        generator: np.random.Generator = self.unwrapped.np_random
        return generator
