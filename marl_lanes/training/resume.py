"""Everything that a run needs to go on as if it had not been interrupted."""

from pathlib import Path
from typing import Any

import torch
from torch import nn

from marl_lanes.files import write_atomically
from marl_lanes.naf.checkpoint import CheckpointError
from marl_lanes.training.collectors import TrafficCollector
from marl_lanes.training.replay import Replay

_FORMAT = "marl-lanes training state 5"


def save_state(
    path: Path,
    *,
    counters: dict[str, float],
    loss: nn.Module,
    optimizer: torch.optim.Optimizer,
    replay: Replay,
    collector: TrafficCollector,
) -> None:
    """Write networks, optimiser, replay buffer, roads, random numbers and counters.

    Raises:
        WorkerError: a worker has died; the file is the one that it was.
    """
    content = {
        "format": _FORMAT,
        "counters": counters,
        "loss": loss.state_dict(),
        "optimizer": optimizer.state_dict(),
        "replay": replay.state(),
        "workers": collector.state(),
        "random": torch.get_rng_state(),
        # A replay buffer in a GPU's memory draws there.
        "random_cuda": torch.cuda.get_rng_state_all() if torch.cuda.is_initialized() else [],
    }
    write_atomically(path, lambda temporary: torch.save(content, temporary))


def read_state(path: Path) -> dict[str, Any]:
    """Read a training state without running any code from it.

    Raises:
        CheckpointError: the file is missing, not readable, or of another form.
    """
    try:
        # Mapped: a replay buffer of files need not fit in memory.
        content: Any = torch.load(path, map_location="cpu", weights_only=True, mmap=True)
    except OSError as error:
        raise CheckpointError(f"training state {path}: cannot be read: {error}") from None
    except Exception as error:  # torch's reader of damaged files raises errors of many kinds
        reason = str(error).partition("\n")[0] or type(error).__name__
        raise CheckpointError(f"training state {path}: cannot be read: {reason}") from None
    if not isinstance(content, dict) or content.get("format") != _FORMAT:
        raise CheckpointError(f"training state {path}: not of the form {_FORMAT!r}")
    return content


def restore_state(
    content: dict[str, Any],
    *,
    loss: nn.Module,
    optimizer: torch.optim.Optimizer,
    replay: Replay,
    collector: TrafficCollector,
) -> None:
    """Put everything back; the random numbers last, for building the others draws some.

    Raises:
        ValueError: the collector has other workers or roads.
    """
    collector.restore(content["workers"])
    loss.load_state_dict(content["loss"])
    optimizer.load_state_dict(content["optimizer"])
    replay.restore(content["replay"])
    torch.set_rng_state(content["random"])
    if content["random_cuda"]:
        torch.cuda.set_rng_state_all(content["random_cuda"])
