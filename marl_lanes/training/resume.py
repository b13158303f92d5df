"""Everything that a run needs to go on as if it had not been interrupted."""

import pickle
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDict
from torch import nn
from torchrl.data import TensorDictReplayBuffer

from marl_lanes.envs.batched import LaneChangeEnv
from marl_lanes.naf.checkpoint import CheckpointError
from marl_lanes.training.files import write_atomically

_FORMAT = "marl-lanes training state 1"


def save_state(
    path: Path,
    *,
    counters: dict[str, float],
    loss: nn.Module,
    optimizer: torch.optim.Optimizer,
    replay: TensorDictReplayBuffer,
    env: LaneChangeEnv,
) -> None:
    """Write networks, optimiser, replay buffer, roads, random numbers and counters."""
    stored = replay[:] if len(replay) else None
    content = {
        "format": _FORMAT,
        "counters": counters,
        "loss": loss.state_dict(),
        "optimizer": optimizer.state_dict(),
        "replay": None if stored is None else dict(stored.flatten_keys(".").items()),
        "cursor": replay.writer._cursor,
        "roads": torch.frombuffer(bytearray(env.simulator.snapshot()), dtype=torch.uint8),
        "random": torch.get_rng_state(),
    }
    write_atomically(path, lambda temporary: torch.save(content, temporary))


def read_state(path: Path) -> dict[str, Any]:
    """Read a training state without running any code from it.

    Raises:
        CheckpointError: the file is missing, not readable, or of another form.
    """
    try:
        content: Any = torch.load(path, map_location="cpu", weights_only=True)
    except OSError as error:
        raise CheckpointError(f"training state {path}: cannot be read: {error}") from None
    except (pickle.UnpicklingError, RuntimeError, EOFError, ValueError, KeyError) as error:
        reason = str(error).partition("\n")[0]
        raise CheckpointError(f"training state {path}: cannot be read: {reason}") from None
    if not isinstance(content, dict) or content.get("format") != _FORMAT:
        raise CheckpointError(f"training state {path}: not of the form {_FORMAT!r}")
    return content


def restore_state(
    content: dict[str, Any],
    *,
    loss: nn.Module,
    optimizer: torch.optim.Optimizer,
    replay: TensorDictReplayBuffer,
    env: LaneChangeEnv,
) -> None:
    """Put everything back; the random numbers last, for building the others draws some."""
    loss.load_state_dict(content["loss"])
    optimizer.load_state_dict(content["optimizer"])
    if content["replay"] is not None:
        flat = content["replay"]
        size = next(iter(flat.values())).shape[0]
        replay.extend(TensorDict(flat, [size]).unflatten_keys("."))
    replay.writer._cursor = content["cursor"]
    env.restore(content["roads"].numpy().tobytes())
    torch.set_rng_state(content["random"])
