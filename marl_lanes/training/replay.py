"""What off-policy updates are drawn from: the newest transitions, and the rare ones once more."""

import os
import shutil
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import LazyMemmapStorage, LazyTensorStorage, TensorDictReplayBuffer

from marl_lanes.training.config import ConfigError, ReplayConfig
from marl_lanes.training.experience import Experience
from marl_lanes.training.transitions import CPU, send

RARE = "is_aborting"
"""The column that says which transitions are rare."""

ROWS_AT_ONCE = 32_768
"""Rows read together, for as many updates as they make."""

_BLOCK = 2**20


class Replay(Experience):
    """Two rings: the newest transitions, and the newest of the rare ones.

    A change that is turned back is one of hundreds, and the way back has to be learned as well: of
    each batch ``rare_share`` are rare ones, as soon as there are so many.

    Args:
        config: capacity, batch size, storage, and the share of the rare ones, whose ring has that
            share of the capacity.
        folder: where ``storage: memmap`` has its files. They are working memory: what an earlier
            process left there is removed, for it may be half written.
        bytes_per_transition: size of a row.
        device: where the batches are needed, and where ``storage: memory`` is.
        transitions_per_update: new transitions for each update.

    Raises:
        ConfigError: the disk has too little room for the files and for the training state, which
            is a copy of them.
    """

    def __init__(
        self,
        config: ReplayConfig,
        folder: Path,
        bytes_per_transition: float,
        device: torch.device = CPU,
        *,
        transitions_per_update: float,
    ) -> None:
        self.folder = folder
        self.warmup = config.warmup_transitions
        self.transitions_per_update = transitions_per_update
        self.batch_size = config.batch_size
        self.device = device
        self.is_in_memory = config.storage == "memory"
        self.num_rare = round(config.rare_share * config.batch_size)
        capacities = {"newest": config.capacity}
        if self.num_rare:
            capacities["rare"] = max(1, round(config.rare_share * config.capacity))
        shutil.rmtree(folder, ignore_errors=True)
        if not self.is_in_memory:
            folder.parent.mkdir(parents=True, exist_ok=True)
            needed = int(2 * sum(capacities.values()) * bytes_per_transition)
            free = shutil.disk_usage(folder.parent).free
            if needed > free:
                raise ConfigError(
                    f"replay.capacity = {config.capacity}: must fit on the disk of "
                    f"{folder.parent}: the replay buffer and the training state take {needed} "
                    f"bytes, {free} are free"
                )
        self.rings = {
            name: TensorDictReplayBuffer(
                storage=LazyTensorStorage(capacity, device=device)
                if self.is_in_memory
                else LazyMemmapStorage(capacity, scratch_dir=str(folder / name))
            )
            for name, capacity in capacities.items()
        }

    def __len__(self) -> int:
        """Transitions in the ring of the newest."""
        return len(self.rings["newest"])

    def extend(self, transitions: TensorDictBase) -> None:
        """Add transitions, (N,), which are on the CPU or the device, over the oldest ones.

        Raises:
            OSError: the disk has no room for the files.
        """
        if self.is_in_memory:
            transitions = send(transitions, self.device)
        self._extend("newest", transitions)
        if "rare" in self.rings and RARE in transitions.keys():  # noqa: SIM118
            # Found once, not for every column: on a GPU that is to wait.
            self._extend("rare", transitions[transitions[RARE].nonzero().squeeze(-1)])

    def _extend(self, name: str, rows: TensorDictBase) -> None:
        if not len(rows):
            return
        ring = self.rings[name]
        # Of two rows for one place the later one stays: a GPU would mix them.
        rows = rows[-ring.storage.max_size :]
        is_first = not len(ring)
        ring.extend(rows)
        if is_first and not self.is_in_memory:
            # The files have holes: to write there on a full disk would end the process.
            for path in (self.folder / name).rglob("*.memmap"):
                _fill_holes(path)

    def num_due(self, transitions: int, updates: int) -> int:
        """Updates that are due: one for so many transitions, beginning after the first ones."""
        due = max(0, transitions - self.warmup) / self.transitions_per_update
        return int(due) - updates

    def draw(self, number: int) -> Iterator[TensorDictBase]:
        """Draw batches one by one, (batch_size,), on the device."""
        at_once = max(1, ROWS_AT_ONCE // self.batch_size)
        while number > 0:
            rows = self.sample(min(number, at_once))
            yield from rows.unbind(0)
            number -= len(rows)

    def sample(self, number: int) -> TensorDictBase:
        """Draw ``number`` batches, (number, batch_size), on the device."""
        rows = self._draw(number)
        return rows if self.is_in_memory else send(rows, self.device)

    def _draw(self, number: int) -> TensorDictBase:
        num_rare = self.num_rare
        if not num_rare or len(self.rings["rare"]) < num_rare:
            return self._draw_from("newest", number, self.batch_size)
        parts = [
            self._draw_from("newest", number, self.batch_size - num_rare),
            self._draw_from("rare", number, num_rare),
        ]
        return torch.cat(parts, dim=1)

    def _draw_from(self, ring: str, number: int, size: int) -> TensorDictBase:
        # One draw of many batches gives the rows that as many draws would give.
        rows: TensorDictBase = self.rings[ring].sample(number * size)
        return rows.reshape(number, size)

    def state(self) -> dict[str, dict[str, Any]]:
        """What ``restore`` takes: of each ring its rows by name and where it is written next."""
        return {
            name: {"rows": _flat(ring), "writer": ring.writer.state_dict()}
            for name, ring in self.rings.items()
        }

    def restore(self, state: Mapping[str, Mapping[str, Any]]) -> None:
        """Go on from what the state of an equal, filled one was; this one is empty."""
        for name, ring in self.rings.items():
            rows = state[name]["rows"]
            if rows:
                size = next(iter(rows.values())).shape[0]
                self._extend(name, TensorDict(rows, [size]).unflatten_keys("."))
            ring.writer.load_state_dict(state[name]["writer"])


def _fill_holes(path: Path) -> None:
    """Give a file all its room on the disk; its content stays."""
    # On Windows files have no holes unless one asks for them.
    if sys.platform != "win32":
        with path.open("r+b") as file:
            if sys.platform == "linux":
                os.posix_fallocate(file.fileno(), 0, path.stat().st_size)
            else:
                while content := file.read(_BLOCK):
                    file.seek(-len(content), os.SEEK_CUR)
                    file.write(content)


def _flat(ring: TensorDictReplayBuffer) -> dict[str, Tensor]:
    """Plain tensors, of files as well: they are written as they are, without a copy in memory."""
    if not len(ring):
        return {}
    stored = ring[:].flatten_keys(".")
    return {key: value.as_subclass(torch.Tensor) for key, value in stored.items()}
