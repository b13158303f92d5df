"""Networks and checkpoints that fit a scenario: those of its changers, those of its followers."""

from collections.abc import Sequence
from pathlib import Path

import torch

from marl_lanes.naf.checkpoint import FORMAT, Checkpoint, CheckpointError, read_checkpoint
from marl_lanes.naf.network import NAFNetwork
from marl_lanes.scenario import Scenario
from marl_lanes.traffic.parameters import action_bounds, follower_action_bounds
from marl_lanes.traffic.roles.observation import FOLLOWER_FEATURES, feature_scaling
from marl_lanes.training.files import write_atomically

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
    features = scenario.observation.features
    offsets, scales = feature_scaling(features)
    low, high = (bound.tolist() for bound in action_bounds(scenario))
    costs = [0.0] * len(low)
    if knows_action_cost and mu.startswith("cascade"):
        costs[0] = scenario.reward.acceleration_weight
    return NAFNetwork(
        features,
        low,
        high,
        mu=mu,
        hidden_sizes=hidden_sizes,
        offsets=offsets,
        scales=scales,
        action_costs=costs,
    )


def make_follower_network(
    scenario: Scenario, hidden_sizes: Sequence[int] = _HIDDEN_SIZES
) -> NAFNetwork:
    """An untrained network of the learned followers; its mu is the general one."""
    low, high = (bound.tolist() for bound in follower_action_bounds(scenario))
    return NAFNetwork(
        [feature.name for feature in FOLLOWER_FEATURES],
        low,
        high,
        mu="mlp",
        hidden_sizes=hidden_sizes,
        offsets=[feature.offset for feature in FOLLOWER_FEATURES],
        scales=[feature.scale for feature in FOLLOWER_FEATURES],
    )


def save_checkpoint(path: Path, network: NAFNetwork, scenario: str, transitions: int) -> None:
    """Write a checkpoint, whole or not at all."""
    content = {
        "format": FORMAT,
        "config": network.config,
        "weights": {key: value.detach().cpu() for key, value in network.state_dict().items()},
        "scenario": scenario,
        "transitions": transitions,
    }
    write_atomically(path, lambda temporary: torch.save(content, temporary))


def load_checkpoint(path: Path, scenario: Scenario) -> Checkpoint:
    """Read a changers' checkpoint that fits the scenario: features in order, action bounds.

    Raises:
        CheckpointError: not readable, not a checkpoint, or it does not fit the scenario.
    """
    whose = f"the changers of scenario {scenario.name!r} have"
    found = read_checkpoint(path)
    features = list(scenario.observation.features)
    if found.network.features != features:
        raise CheckpointError(
            f"checkpoint {path}: its features are {found.network.features}, {whose} {features}"
        )
    config = found.network.config
    bounds = [bound.tolist() for bound in action_bounds(scenario)]
    if [config["action_low"], config["action_high"]] != bounds:
        raise CheckpointError(
            f"checkpoint {path}: its action bounds are {config['action_low']} to "
            f"{config['action_high']}, {whose} {bounds[0]} to {bounds[1]}"
        )
    return found
