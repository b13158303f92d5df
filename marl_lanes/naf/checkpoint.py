"""Checkpoints as they are read: the network's form and weights, and nothing that runs code."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, Protocol, Self, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict.nn import TensorDictModule

from marl_lanes.naf.layers import ActionBox
from marl_lanes.naf.network import NAFNetwork

FORMAT = "marl-lanes NAF policy 4"
"""What a checkpoint's entry ``format`` says."""


class CheckpointError(ValueError):
    """A file that is not a checkpoint, or does not fit the scenario."""


class PolicyNetwork(Protocol):
    """What checkpoints and policies need of a network, which is an ``nn.Module``."""

    features: list[str]
    box: ActionBox

    @property
    def config(self) -> dict[str, Any]:
        """Constructor arguments in plain Python types, ``action_low`` and ``_high`` among them."""

    def policy(self) -> TensorDictModule:
        """The greedy policy; its ``module`` maps observations (N, F) to actions (N, D)."""

    def state_dict(self) -> dict[str, Any]:
        """The weights."""

    def load_state_dict(self, state_dict: dict[str, Any]) -> object:
        """Set the weights."""

    def to(self, device: torch.device) -> Self:
        """The network itself, moved to the device."""


Network = TypeVar("Network", bound=PolicyNetwork, covariant=True)


@dataclass(frozen=True)
class Checkpoint(Generic[Network]):
    """A policy as it was saved."""

    network: Network
    scenario: str
    """Name of the scenario that it was trained on."""
    transitions: int
    """Transitions that it has learned from."""


def read_checkpoint(path: Path) -> Checkpoint[NAFNetwork]:
    """Read a checkpoint of NAF without running any code from it.

    Raises:
        CheckpointError: not readable, or not a checkpoint of NAF.
    """
    content = read_content(path)
    if content.get("format") != FORMAT:
        raise CheckpointError(f"checkpoint {path}: not a checkpoint of the form {FORMAT!r}")
    return build_checkpoint(path, content, NAFNetwork)


def read_content(path: Path) -> dict[str, Any]:
    """The content of a checkpoint of any form, read without running any code from it.

    Returns:
        the content; empty if the file holds something else than a mapping.

    Raises:
        CheckpointError: the file cannot be read.
    """
    try:
        content: Any = torch.load(path, map_location="cpu", weights_only=True)
    except OSError as error:
        raise CheckpointError(f"checkpoint {path}: cannot be read: {error}") from None
    except Exception as error:  # torch's reader of damaged files raises errors of many kinds
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise CheckpointError(f"checkpoint {path}: not a checkpoint: {reason}") from None
    return content if isinstance(content, dict) else {}


def build_checkpoint(
    path: Path, content: dict[str, Any], kind: Callable[..., Network]
) -> Checkpoint[Network]:
    """Make a checkpoint's network.

    Args:
        path: the file, for messages.
        content: its content, with the ``format`` of the network's class.
        kind: the network's class.

    Raises:
        CheckpointError: a part is missing, or the parts do not fit together.
    """
    try:
        network = kind(**content["config"])
        network.load_state_dict(content["weights"])
        return Checkpoint(network, str(content["scenario"]), int(content["transitions"]))
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        reason = str(error).partition("\n")[0]
        raise CheckpointError(f"checkpoint {path}: inconsistent: {reason}") from None


def greedy_policy(network: PolicyNetwork) -> Callable[[NDArray[np.float32]], NDArray[np.float64]]:
    """The network's greedy action as a function of arrays, (N, F) to (N, D)."""
    module = network.policy().module

    def act(observations: NDArray[np.float32]) -> NDArray[np.float64]:
        with torch.inference_mode():
            actions = module(torch.from_numpy(observations).to(network.box.low.device))
        return np.asarray(actions.cpu().numpy(), np.float64)

    return act
