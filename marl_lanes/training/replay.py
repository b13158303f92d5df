"""The replay buffer: in memory, or in files of the run folder."""

import shutil
from pathlib import Path

import torch
from torchrl.data import LazyMemmapStorage, LazyTensorStorage, TensorDictReplayBuffer

from marl_lanes.training.config import ConfigError, ReplayConfig
from marl_lanes.training.transitions import CPU


def make_replay(
    config: ReplayConfig, folder: Path, bytes_per_transition: float, device: torch.device = CPU
) -> TensorDictReplayBuffer:
    """An empty replay buffer.

    Args:
        config: its capacity and its storage.
        folder: where ``storage: memmap`` has its files. They are working memory: what an earlier
            process left there is removed, for it may be half written.
        bytes_per_transition: size of a row.
        device: where ``storage: memory`` is.

    Raises:
        ConfigError: the disk has too little room for the files and for the training state, which
            is a copy of them.
    """
    shutil.rmtree(folder, ignore_errors=True)
    if config.storage == "memory":
        storage = LazyTensorStorage(config.capacity, device=device)
    else:
        folder.parent.mkdir(parents=True, exist_ok=True)
        needed = int(2 * config.capacity * bytes_per_transition)
        free = shutil.disk_usage(folder.parent).free
        if needed > free:
            raise ConfigError(
                f"replay.capacity = {config.capacity}: must fit on the disk of {folder.parent}: "
                f"the replay buffer and the training state take {needed} bytes, {free} are free"
            )
        storage = LazyMemmapStorage(config.capacity, scratch_dir=str(folder))
    return TensorDictReplayBuffer(storage=storage)
