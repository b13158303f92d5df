"""Checkpoints of a policy: the network's form and weights, and nothing that runs code."""

import pickle
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from marl_lanes.naf.network import NAFNetwork
from marl_lanes.scenario import Scenario
from marl_lanes.traffic.observation import feature_scaling
from marl_lanes.training.files import write_atomically

_FORMAT = "marl-lanes NAF policy 1"


class CheckpointError(ValueError):
    """A file that is not a checkpoint, or does not fit the scenario."""


@dataclass(frozen=True)
class Checkpoint:
    """A policy as it was saved."""

    network: NAFNetwork
    scenario: str
    """Name of the scenario that it was trained on."""
    transitions: int
    """Transitions that it has learned from."""


def make_network(scenario: Scenario, mu: str, hidden_sizes: list[int] | None = None) -> NAFNetwork:
    """An untrained network for the scenario's features and action bounds."""
    features = scenario.observation.features
    offsets, scales = feature_scaling(features)
    bound = scenario.action.max_yaw_acceleration
    return NAFNetwork(
        features,
        [-bound],
        [bound],
        mu=mu,
        hidden_sizes=(64, 64) if hidden_sizes is None else hidden_sizes,
        offsets=offsets,
        scales=scales,
    )


def greedy_policy(network: NAFNetwork) -> Callable[[NDArray[np.float32]], NDArray[np.float64]]:
    """The network's greedy action as a function of arrays, (N, F) to (N, D)."""
    module = network.policy().module

    def act(observations: NDArray[np.float32]) -> NDArray[np.float64]:
        with torch.inference_mode():
            actions = module(torch.from_numpy(observations))
        return np.asarray(actions.numpy(), np.float64)

    return act


def save_checkpoint(path: Path, network: NAFNetwork, scenario: str, transitions: int) -> None:
    """Write a checkpoint, whole or not at all."""
    content = {
        "format": _FORMAT,
        "config": network.config,
        "weights": {key: value.detach().cpu() for key, value in network.state_dict().items()},
        "scenario": scenario,
        "transitions": transitions,
    }
    write_atomically(path, lambda temporary: torch.save(content, temporary))


def load_checkpoint(path: Path, scenario: Scenario | None = None) -> Checkpoint:
    """Read a checkpoint without running any code from it.

    Args:
        path: the file.
        scenario: when given, what the policy must fit: features in order, action bounds.

    Raises:
        CheckpointError: not readable, not a checkpoint, or it does not fit the scenario.
    """
    try:
        content: Any = torch.load(path, map_location="cpu", weights_only=True)
    except OSError as error:
        raise CheckpointError(f"checkpoint {path}: cannot be read: {error}") from None
    except (pickle.UnpicklingError, RuntimeError, EOFError, ValueError, KeyError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise CheckpointError(f"checkpoint {path}: not a checkpoint: {reason}") from None
    if not isinstance(content, dict) or content.get("format") != _FORMAT:
        raise CheckpointError(f"checkpoint {path}: not a checkpoint of the form {_FORMAT!r}")
    try:
        network = NAFNetwork(**content["config"])
        network.load_state_dict(content["weights"])
        found = Checkpoint(network, str(content["scenario"]), int(content["transitions"]))
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        reason = str(error).partition("\n")[0]
        raise CheckpointError(f"checkpoint {path}: inconsistent: {reason}") from None
    if scenario is not None:
        _check_fit(path, network, scenario)
    return found


def _check_fit(path: Path, network: NAFNetwork, scenario: Scenario) -> None:
    wanted = list(scenario.observation.features)
    if network.features != wanted:
        raise CheckpointError(
            f"checkpoint {path}: its features are {network.features}, scenario "
            f"{scenario.name!r} has {wanted}"
        )
    bound = scenario.action.max_yaw_acceleration
    if network.config["action_high"] != [np.float32(bound)]:
        raise CheckpointError(
            f"checkpoint {path}: its action bound is {network.config['action_high']}, scenario "
            f"{scenario.name!r} has [{bound}]"
        )
