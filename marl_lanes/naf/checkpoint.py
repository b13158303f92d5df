"""Checkpoints as they are read: the network's form and weights, and nothing that runs code."""

import pickle
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from marl_lanes.naf.network import NAFNetwork

FORMAT = "marl-lanes NAF policy 4"
"""What a checkpoint's entry ``format`` says."""


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


def read_checkpoint(path: Path) -> Checkpoint:
    """Read a checkpoint without running any code from it.

    Raises:
        CheckpointError: not readable, or not a checkpoint.
    """
    try:
        content: Any = torch.load(path, map_location="cpu", weights_only=True)
    except OSError as error:
        raise CheckpointError(f"checkpoint {path}: cannot be read: {error}") from None
    except (pickle.UnpicklingError, RuntimeError, EOFError, ValueError, KeyError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise CheckpointError(f"checkpoint {path}: not a checkpoint: {reason}") from None
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise CheckpointError(f"checkpoint {path}: not a checkpoint of the form {FORMAT!r}")
    try:
        network = NAFNetwork(**content["config"])
        network.load_state_dict(content["weights"])
        return Checkpoint(network, str(content["scenario"]), int(content["transitions"]))
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        reason = str(error).partition("\n")[0]
        raise CheckpointError(f"checkpoint {path}: inconsistent: {reason}") from None


def greedy_policy(network: NAFNetwork) -> Callable[[NDArray[np.float32]], NDArray[np.float64]]:
    """The network's greedy action as a function of arrays, (N, F) to (N, D)."""
    module = network.policy().module

    def act(observations: NDArray[np.float32]) -> NDArray[np.float64]:
        with torch.inference_mode():
            actions = module(torch.from_numpy(observations).to(network.box.low.device))
        return np.asarray(actions.cpu().numpy(), np.float64)

    return act
