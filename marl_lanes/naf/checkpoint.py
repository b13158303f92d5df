"""Checkpoints as they are read: the network's form and weights, and nothing that runs code."""

import pickle
import reprlib
import textwrap
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, BinaryIO, Generic, Protocol, Self, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict.nn import TensorDictModule

from marl_lanes.files import open_regular, write_atomically
from marl_lanes.naf.encoder import make_encoder
from marl_lanes.naf.layers import ActionBox
from marl_lanes.naf.network import NAFNetwork
from marl_lanes.zoo.index import PREFIX, ZooError, find_file

FORMAT = "marl-lanes NAF policy 4"
"""What a checkpoint's entry ``format`` says."""

_MAX_REASON = 300
"""[characters] of a reason that a network's constructor gives."""


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

    Args:
        path: of the file, or ``zoo:NAME``.

    Returns:
        the content; empty if the file holds something else than a mapping.

    Raises:
        CheckpointError: the file cannot be read.
    """
    return read_archive(find_checkpoint(path), "checkpoint")


def find_checkpoint(path: Path) -> Path:
    """The file of a checkpoint: of ``zoo:NAME``, which is no path, that of the zoo.

    Raises:
        CheckpointError: the zoo has no such policy, or its file is damaged.
    """
    name = str(path)
    if not name.startswith(PREFIX):
        return path
    try:
        return find_file(name)
    except (OSError, ZooError) as error:
        raise CheckpointError(f"checkpoint {name}: {error}") from None


def read_archive(path: Path, kind: str, *, is_mapped: bool = False) -> dict[str, Any]:
    """The content of a file of ``torch.save``, every byte of it verified, no code of it run.

    Args:
        path: the file.
        kind: what it should be, for messages.
        is_mapped: leave its tensors on the disk until they are read.

    Returns:
        the content; empty if the file holds something else than a mapping.

    Raises:
        CheckpointError: the file cannot be read, or is not as it was written.
    """
    try:
        with open_regular(path) as file:
            _verify(file)
            file.seek(0)
            source = path if is_mapped else file
            content: Any = torch.load(source, map_location="cpu", weights_only=True, mmap=is_mapped)
    except OSError as error:
        reason = error.strerror or str(error)
        raise CheckpointError(f"{kind} {path}: cannot be read: {reason}") from None
    except pickle.UnpicklingError:
        raise CheckpointError(
            f"{kind} {path}: not a {kind}: must hold plain values and tensors alone"
        ) from None
    except Exception as error:  # torch's reader of damaged files raises errors of many kinds
        reason = str(error).partition("\n")[0] or type(error).__name__
        raise CheckpointError(f"{kind} {path}: not a {kind}: {reason}") from None
    return content if isinstance(content, dict) else {}


def _verify(file: BinaryIO) -> None:
    """Compare every entry with its CRC-32, which ``torch.load`` does not.

    Raises:
        ValueError, zipfile.BadZipFile: the file is not as ``torch.save`` wrote it.
    """
    with zipfile.ZipFile(file) as archive:
        entries = archive.infolist()
        # Compressed, a small file could fill the memory; of a folder torch reads what is in memory
        # by chance; of two of a name one is not verified.
        if any(entry.compress_type or entry.external_attr for entry in entries):
            raise ValueError("its entries must be files that are not compressed")
        if len({entry.filename for entry in entries}) < len(entries):
            raise ValueError("an entry is there twice")
        damaged = archive.testzip()
    if damaged is not None:
        raise ValueError(f"the checksum of its entry {damaged!r} is wrong")


def write_archive(path: Path, content: Mapping[str, Any]) -> None:
    """Write plain values and tensors with ``torch.save``, whole or not at all.

    Raises:
        OSError: the file cannot be written; what was there stays as it was.
    """
    # It is on unless somebody has turned it off.
    torch.serialization.set_crc32_options(True)

    def write(temporary: Path) -> None:
        # Given a path, torch would write its name into the file, and of a full disk raise an error
        # of its own.
        with temporary.open("wb") as file:
            torch.save(content, file)

    write_atomically(path, write)


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
        config, weights = content["config"], content["weights"]
        _check_config(config, weights)
        network = kind(**config)
        check_tensors(weights, network.state_dict())
        network.load_state_dict(weights)
        scenario, transitions = content["scenario"], content["transitions"]
        if not isinstance(scenario, str) or not isinstance(transitions, int):
            raise TypeError("scenario and transitions: must be a text and a whole number")
    except KeyError as error:
        raise CheckpointError(f"checkpoint {path}: {error}: must be given") from None
    except (AttributeError, TypeError, ValueError, RuntimeError) as error:
        reason = textwrap.shorten(str(error), _MAX_REASON)
        raise CheckpointError(f"checkpoint {path}: inconsistent: {reason}") from None
    return Checkpoint(network, scenario, transitions)


def _check_config(config: Mapping[str, Any], weights: Mapping[str, Any]) -> None:
    """Refuse the arguments of a network that are no plain values, or need more than the weights.

    Raises:
        TypeError, ValueError: what is wrong; the network must not be made.
    """
    for name, value in config.items():
        parts = value if isinstance(value, list | tuple) else [value]
        if not all(part is None or isinstance(part, str | int | float) for part in parts):
            raise TypeError(f"config.{name}: must be a plain value or a list of them")
    encoder = make_encoder(config.get("encoder", "none"), config["features"])
    widths = [len(encoder.outputs), *config["hidden_sizes"]]
    needed = sum(max(1, before * after) for before, after in pairwise(widths))
    stored = sum(weight.untyped_storage().nbytes() // 4 for weight in weights.values())
    if needed > stored:
        raise ValueError(
            f"config.hidden_sizes = {reprlib.repr(config['hidden_sizes'])}: must be that of the "
            f"{stored} weights in the file"
        )


def check_tensors(found: Mapping[str, Any], wanted: Mapping[str, Any]) -> None:
    """Refuse tensors of other names or forms, or with a number that is not finite.

    Args:
        found: from a file.
        wanted: those that they are for; what is no tensor there is not looked at.

    Raises:
        ValueError: the message names the tensor.
    """
    if found.keys() != wanted.keys():
        names = reprlib.repr(sorted(map(str, found.keys() ^ wanted.keys())))
        raise ValueError(f"weights: {names}: must be there if and only if the network has them")
    for name, tensor in wanted.items():
        if not isinstance(tensor, torch.Tensor):
            continue
        form = _form_of(found[name])
        if form != _form_of(tensor):
            raise ValueError(f"weights.{name}: {form}: must be {_form_of(tensor)}")
        if not torch.isfinite(found[name]).all():
            raise ValueError(f"weights.{name}: every number must be finite")


def _form_of(value: Any) -> str:
    if not isinstance(value, torch.Tensor) or value.layout != torch.strided:
        return "no dense tensor"
    order = "" if value.is_contiguous() else " in another order"
    return f"{value.dtype} of shape {tuple(value.shape)}{order}"


def greedy_policy(network: PolicyNetwork) -> Callable[[NDArray[np.float32]], NDArray[np.float64]]:
    """The network's greedy action as a function of arrays, (N, F) to (N, D)."""
    module = network.policy().module

    def act(observations: NDArray[np.float32]) -> NDArray[np.float64]:
        with torch.inference_mode():
            actions = module(torch.from_numpy(observations).to(network.box.low.device))
        return np.asarray(actions.cpu().numpy(), np.float64)

    return act
