"""The specs of the TorchRL environment: what the groups of its roles see, do and are paid."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import torch
from torchrl.data import Bounded, Categorical, Composite, Unbounded

from marl_lanes.envs.vehicle_table import state_bounds
from marl_lanes.scenario import Scenario
from marl_lanes.traffic.machine.state import Outcome
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.traffic.roles.role import Bounds, Role

ENDS = ("done", "terminated", "truncated")
_CPU = torch.device("cpu")


class Specs(NamedTuple):
    """Of an environment, with batch size [E]."""

    observation: Composite
    action: Composite
    reward: Composite
    done: Composite


def make_specs(
    scenario: Scenario, roles: Sequence[Role], num_envs: int, *, has_state: bool
) -> Specs:
    """Make the specs in the computer's memory, whatever torch's defaults are.

    Args:
        scenario: of the roads.
        roles: whose groups there are.
        num_envs: E, the number of roads.
        has_state: whether the root has a ``state``.

    Returns:
        Specs of tensors (E, A, ...) in the groups and (E, ...) in the root.
    """
    group = (num_envs, scenario.num_slots)
    # Of two categories, as in TorchRL's PettingZooWrapper: a Binary cannot lose a dimension.
    flag = Categorical(2, shape=(*group, 1), dtype=torch.bool, device=_CPU)
    mask = Categorical(2, shape=group, dtype=torch.bool, device=_CPU)
    total = Unbounded((*group, 1), dtype=torch.float32, device=_CPU)
    seen: dict[str, dict[str, Any]] = {
        role.group: {
            "observation": _bounded(role.observation_bounds(scenario), group),
            "mask": mask.clone(),
            "acting": mask.clone(),
            "command_reward": total.clone(),
        }
        for role in roles
    }
    seen[CHANGER.group] |= {
        "steering": mask.clone(),
        "aborting": mask.clone(),
        "outcome": Bounded(0, max(Outcome), group, dtype=torch.int64, device=_CPU),
    }
    observation = _grouped(seen, group)
    if has_state:
        bounds = state_bounds(scenario, scenario.num_slots)
        observation["state"] = _bounded(bounds, (num_envs,))
    action = {
        role.group: {"action": _bounded(role.action_bounds(scenario), group)} for role in roles
    }
    reward = {role.group: {"reward": total.clone()} for role in roles}
    done = _grouped({role.group: {key: flag.clone() for key in ENDS} for role in roles}, group)
    for key in ENDS:
        done[key] = Categorical(2, shape=(num_envs, 1), dtype=torch.bool, device=_CPU)
    return Specs(observation, _grouped(action, group), _grouped(reward, group), done)


def _grouped(groups: Mapping[str, Mapping[str, Any]], shape: tuple[int, int]) -> Composite:
    inner = {name: Composite(dict(leaves), shape=shape) for name, leaves in groups.items()}
    return Composite(inner, shape=shape[:1])


def _bounded(bounds: Bounds, batch: tuple[int, ...]) -> Bounded:
    """The spec of (*batch, *shape) with two arrays of the shape as bounds."""
    shape = (*batch, *bounds[0].shape)
    low, high = (torch.tensor(bound, device=_CPU).expand(shape) for bound in bounds)
    return Bounded(low, high, shape, dtype=torch.float32, device=_CPU)
