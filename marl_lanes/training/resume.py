"""Everything that a run needs to go on as if it had not been interrupted."""

import copy
import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import nn

from marl_lanes.naf.checkpoint import CheckpointError, check_tensors, read_archive, write_archive
from marl_lanes.training.collectors import TrafficCollector, WorkerError
from marl_lanes.training.experience import Experience

_FORMAT = "marl-lanes training state 6"


def save_state(
    path: Path,
    *,
    counters: dict[str, float],
    tables: Mapping[str, Mapping[str, int | str]],
    loss: nn.Module,
    optimizer: torch.optim.Optimizer,
    experience: Experience,
    collector: TrafficCollector,
) -> None:
    """Write networks, optimiser, replay buffer, roads, random numbers and counters.

    Args:
        path: of the file.
        counters: how far the run is.
        tables: where its tables end, from ``RunFolder.take_extents``.
        loss: with the networks.
        optimizer: of the loss.
        experience: what the updates are drawn from.
        collector: with the roads.

    Raises:
        OSError: the file cannot be written; the one that was there stays.
        WorkerError: a worker has died; the file is the one that it was.
    """
    content = {
        "format": _FORMAT,
        "counters": counters,
        "tables": tables,
        "loss": loss.state_dict(),
        "optimizer": optimizer.state_dict(),
        "replay": experience.state(),
        "workers": collector.state(),
        "random": torch.get_rng_state(),
        # A replay buffer in a GPU's memory draws there.
        "random_cuda": torch.cuda.get_rng_state_all() if torch.cuda.is_initialized() else [],
    }
    write_archive(path, content)


def read_state(path: Path) -> dict[str, Any]:
    """Read a training state, every byte of it verified, without running any code from it.

    Raises:
        CheckpointError: the file is missing, damaged, or of another form.
    """
    if not path.exists():
        raise CheckpointError(
            f"training state {path}: there is none: the run was ended before it began; begin "
            "another in another folder"
        )
    # Mapped: a replay buffer of files need not fit in memory.
    content = read_archive(path, "training state", is_mapped=True)
    if content.get("format") != _FORMAT:
        raise CheckpointError(f"training state {path}: not of the form {_FORMAT!r}")
    return content


def restore_state(
    path: Path,
    content: Mapping[str, Any],
    *,
    loss: nn.Module,
    optimizer: torch.optim.Optimizer,
    experience: Experience,
    collector: TrafficCollector,
) -> None:
    """Put everything back; the random numbers last, for building the others draws some.

    Args:
        path: of the file, for messages.
        content: from ``read_state``.
        loss: of an equal run, as the others.
        optimizer: its optimizer.
        experience: what its updates are drawn from, empty.
        collector: its collector.

    Raises:
        CheckpointError: the state is that of another run: its networks, replay buffer, workers or
            roads have other forms.
        WorkerError: a worker has died.
    """
    try:
        collector.restore(content["workers"])
        check_tensors(content["loss"], loss.state_dict())
        loss.load_state_dict(content["loss"])
        # The optimizer keeps the tensors that it is given: those of the file would keep it open.
        optimizer.load_state_dict(copy.deepcopy(content["optimizer"]))
        experience.restore(content["replay"])
        torch.set_rng_state(content["random"])
        # There may be fewer GPUs now.
        there = range(torch.cuda.device_count())
        for number, state in zip(there, content["random_cuda"], strict=False):
            torch.cuda.set_rng_state(state, number)
    except WorkerError:
        raise
    except (AttributeError, IndexError, KeyError, TypeError, ValueError, RuntimeError) as error:
        reason = textwrap.shorten(str(error), 300)
        raise CheckpointError(f"training state {path}: does not fit this run: {reason}") from None
