"""What the updates are drawn from: the interface, and the newest batch alone."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from typing import Any

import torch
from tensordict import TensorDictBase

from marl_lanes.training.config import EpochsConfig


class Experience(ABC):
    """Transitions, and the batches of the updates that are made of them."""

    @abstractmethod
    def extend(self, transitions: TensorDictBase) -> None:
        """Take the transitions of a collected batch, (N,)."""

    @abstractmethod
    def num_due(self, transitions: int, updates: int) -> int:
        """Updates to make now.

        Args:
            transitions: collected so far.
            updates: made so far.
        """

    @abstractmethod
    def draw(self, number: int) -> Iterator[TensorDictBase]:
        """The batches of so many updates, on the device."""

    @abstractmethod
    def state(self) -> Mapping[str, Any]:
        """What ``restore`` takes: plain values and tensors."""

    @abstractmethod
    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from what the state of an equal one was; this one is empty."""


class Epochs(Experience):
    """The newest batch: each epoch goes through it once, in parts, in an order of its own.

    Nothing of it is left when the next one is collected, so nothing of it is saved.

    Args:
        config: how often, and in parts of what size; the parts are equal but for one transition.
    """

    def __init__(self, config: EpochsConfig) -> None:
        self.config = config
        self.rows: TensorDictBase | None = None

    @property
    def num_parts(self) -> int:
        """Updates of an epoch."""
        count = 0 if self.rows is None else len(self.rows)
        return max(min(count, 1), round(count / self.config.batch_size))

    def extend(self, transitions: TensorDictBase) -> None:
        """Take these instead of what was there, which is used up."""
        self.rows = transitions

    def num_due(self, transitions: int, updates: int) -> int:  # noqa: ARG002
        """Those of all epochs."""
        return self.config.num_epochs * self.num_parts

    def draw(self, number: int) -> Iterator[TensorDictBase]:
        """The parts of one epoch after the other."""
        rows = self.rows
        while rows is not None and number > 0:
            order = torch.randperm(len(rows), device=rows.device)
            for part in order.tensor_split(self.num_parts)[:number]:
                yield rows[part]
            number -= self.num_parts

    def state(self) -> dict[str, Any]:
        """Nothing."""
        return {}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Nothing is needed."""
