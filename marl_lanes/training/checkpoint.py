"""Networks for a role on a scenario, and checkpoints of them."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from marl_lanes.envs.fit import check_fit, network_form
from marl_lanes.naf.checkpoint import (
    FORMAT,
    Checkpoint,
    CheckpointError,
    PolicyNetwork,
    build_checkpoint,
    read_checkpoint,
    read_content,
    write_archive,
)
from marl_lanes.naf.network import NAFNetwork
from marl_lanes.scenario import Scenario
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.traffic.roles.role import Role
from marl_lanes.training.algorithms.actor_critic import ActorNetwork

FORMATS: Mapping[str, Callable[..., PolicyNetwork]] = {
    FORMAT: NAFNetwork,
    "marl-lanes actor policy 1": ActorNetwork,
}
"""Class of the network by a checkpoint's entry ``format``."""

_HIDDEN_SIZES = (64, 64)


def make_network(
    scenario: Scenario,
    mu: str,
    hidden_sizes: Sequence[int] = _HIDDEN_SIZES,
    *,
    role: Role = CHANGER,
    encoder: str = "none",
    knows_action_cost: bool = True,
    off_diagonal: bool = True,
) -> NAFNetwork:
    """An untrained network for the features and action bounds of a role.

    Args:
        scenario: whose agents it drives.
        mu: structure of mu; of followers ``mlp``.
        hidden_sizes: widths of the hidden layers of each network.
        role: of the agents.
        encoder: ``none``, ``gru`` if the scenario stacks observations, ``grid`` if it has a grid.
        knows_action_cost: where mu can say exactly 0 (cascade), whether Q has the reward's own cost
            of the yaw acceleration in it; otherwise it is a plain parabola.
        off_diagonal: whether M of two actions is a full matrix.
    """
    form = network_form(role, scenario)
    costs = [0.0] * len(form["action_low"])
    if knows_action_cost and mu.startswith("cascade"):
        costs[0] = scenario.reward.yaw_acceleration_weight
    return NAFNetwork(
        **form,
        mu=mu,
        encoder=encoder,
        hidden_sizes=hidden_sizes,
        action_costs=costs,
        off_diagonal=off_diagonal,
    )


def make_actor_network(
    scenario: Scenario, hidden_sizes: Sequence[int] = _HIDDEN_SIZES, *, role: Role = CHANGER
) -> ActorNetwork:
    """An untrained actor for the features and action bounds of a role."""
    return ActorNetwork(**network_form(role, scenario), hidden_sizes=hidden_sizes)


def save_checkpoint(path: Path, network: PolicyNetwork, scenario: str, transitions: int) -> None:
    """Write a checkpoint, whole or not at all.

    Raises:
        OSError: it cannot be written.
    """
    (form,) = [form for form, kind in FORMATS.items() if kind is type(network)]
    content: dict[str, Any] = {
        "format": form,
        "config": network.config,
        "weights": {key: value.detach().cpu() for key, value in network.state_dict().items()},
        "scenario": scenario,
        "transitions": transitions,
    }
    write_archive(path, content)


def load_checkpoint(path: Path, scenario: Scenario) -> Checkpoint[NAFNetwork]:
    """Read a changers' checkpoint of NAF that fits the scenario.

    Raises:
        CheckpointError: as for ``load_policy``, or it is not a checkpoint of NAF.
    """
    found = read_checkpoint(path)
    check_fit(path, found.network, CHANGER, scenario)
    return found


def load_policy(path: Path, scenario: Scenario) -> Checkpoint[PolicyNetwork]:
    """Read a changers' checkpoint of any form that fits the scenario.

    It fits if the features, with their order, and the action bounds are the same. Code in it is
    never run.

    Raises:
        CheckpointError: not readable, not a checkpoint, or it does not fit the scenario.
    """
    content = read_content(path)
    kind = FORMATS.get(str(content.get("format")))
    if kind is None:
        raise CheckpointError(
            f"checkpoint {path}: not a checkpoint of the forms {', '.join(map(repr, FORMATS))}"
        )
    found = build_checkpoint(path, content, kind)
    check_fit(path, found.network, CHANGER, scenario)
    return found
