"""Networks and checkpoints that fit a scenario: those of its changers, those of its followers."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import torch

from marl_lanes.files import write_atomically
from marl_lanes.naf.checkpoint import (
    FORMAT,
    Checkpoint,
    CheckpointError,
    PolicyNetwork,
    build_checkpoint,
    read_checkpoint,
    read_content,
)
from marl_lanes.naf.network import NAFNetwork
from marl_lanes.scenario import Scenario
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.traffic.roles.follower import FOLLOWER
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
    knows_action_cost: bool = True,
) -> NAFNetwork:
    """An untrained network of the changers, for their features and action bounds.

    Args:
        scenario: whose changers it drives.
        mu: structure of mu.
        hidden_sizes: widths of the hidden layers of each network.
        knows_action_cost: where mu can say exactly 0 (cascade), whether Q has the reward's own cost
            of the yaw acceleration in it; otherwise it is a plain parabola.
    """
    seen = CHANGER.seen(scenario)
    low, high = (bound.tolist() for bound in CHANGER.action_bounds(scenario))
    costs = [0.0] * len(low)
    if knows_action_cost and mu.startswith("cascade"):
        costs[0] = scenario.reward.yaw_acceleration_weight
    return NAFNetwork(
        [feature.name for feature in seen],
        low,
        high,
        mu=mu,
        hidden_sizes=hidden_sizes,
        offsets=[feature.offset for feature in seen],
        scales=[feature.scale for feature in seen],
        action_costs=costs,
    )


def make_follower_network(
    scenario: Scenario, hidden_sizes: Sequence[int] = _HIDDEN_SIZES
) -> NAFNetwork:
    """An untrained network of the learned followers; its mu is the general one."""
    low, high = (bound.tolist() for bound in FOLLOWER.action_bounds(scenario))
    return NAFNetwork(
        [feature.name for feature in FOLLOWER.features],
        low,
        high,
        mu="mlp",
        hidden_sizes=hidden_sizes,
        offsets=[feature.offset for feature in FOLLOWER.features],
        scales=[feature.scale for feature in FOLLOWER.features],
    )


def make_actor_network(
    scenario: Scenario, hidden_sizes: Sequence[int] = _HIDDEN_SIZES
) -> ActorNetwork:
    """An untrained actor of the changers, for their features and action bounds."""
    seen = CHANGER.seen(scenario)
    low, high = (bound.tolist() for bound in CHANGER.action_bounds(scenario))
    return ActorNetwork(
        [feature.name for feature in seen],
        low,
        high,
        hidden_sizes=hidden_sizes,
        offsets=[feature.offset for feature in seen],
        scales=[feature.scale for feature in seen],
    )


def save_checkpoint(path: Path, network: PolicyNetwork, scenario: str, transitions: int) -> None:
    """Write a checkpoint, whole or not at all."""
    (form,) = [form for form, kind in FORMATS.items() if kind is type(network)]
    content: dict[str, Any] = {
        "format": form,
        "config": network.config,
        "weights": {key: value.detach().cpu() for key, value in network.state_dict().items()},
        "scenario": scenario,
        "transitions": transitions,
    }
    write_atomically(path, lambda temporary: torch.save(content, temporary))


def load_checkpoint(path: Path, scenario: Scenario) -> Checkpoint[NAFNetwork]:
    """Read a changers' checkpoint of NAF that fits the scenario.

    Raises:
        CheckpointError: as for ``load_policy``, or it is not a checkpoint of NAF.
    """
    found = read_checkpoint(path)
    _check_fit(path, found.network, scenario)
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
    _check_fit(path, found.network, scenario)
    return found


def _check_fit(path: Path, network: PolicyNetwork, scenario: Scenario) -> None:
    whose = f"the changers of scenario {scenario.name!r} have"
    features = list(scenario.observation.features)
    if network.features != features:
        raise CheckpointError(
            f"checkpoint {path}: its features are {network.features}, {whose} {features}"
        )
    config = network.config
    bounds = [bound.tolist() for bound in CHANGER.action_bounds(scenario)]
    if [config["action_low"], config["action_high"]] != bounds:
        raise CheckpointError(
            f"checkpoint {path}: its action bounds are {config['action_low']} to "
            f"{config['action_high']}, {whose} {bounds[0]} to {bounds[1]}"
        )
