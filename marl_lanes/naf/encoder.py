"""Encoders: what the networks of V, M and mu see of the normalized observation."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn


class PlainEncoder(nn.Identity):
    """All columns, as they are.

    Args:
        features: names of the observation's columns.

    Attributes:
        outputs: names of the columns that it gives.
    """

    def __init__(self, features: Sequence[str]) -> None:
        super().__init__()
        self.outputs = list(features)


class GRUEncoder(nn.Module):
    """The newest of the stacked observations, and the state of a GRU that has read all of them.

    The GRU begins with the oldest one, at 0. It has no state between two calls, so a transition
    from a replay buffer is read as it was when the agent acted.

    Args:
        features: names of the observation's columns: those of the newest observation, then the same
            with ``@1``, ``@2``, ... for the observations of the steps before.

    Attributes:
        outputs: names of the columns that it gives, those of the newest observation first.

    Raises:
        ValueError: the columns are not those of two or more observations.
    """

    HIDDEN_SIZE = 32

    def __init__(self, features: Sequence[str]) -> None:
        super().__init__()
        newest = [name for name in features if "@" not in name]
        self.num_stacked = len(features) // max(1, len(newest))
        before = [f"{name}@{i}" for i in range(1, self.num_stacked) for name in newest]
        if self.num_stacked < 2 or list(features) != newest + before:
            raise ValueError(
                f"encoder 'gru' needs two or more stacked observations, got {', '.join(features)}"
            )
        self.outputs = newest + [f"state_{i}" for i in range(self.HIDDEN_SIZE)]
        # A cell, not nn.GRU, which keeps its own references to its weights: a loss puts those of a
        # target in their place.
        self.cell = nn.GRUCell(len(newest), self.HIDDEN_SIZE, dtype=torch.float32)

    def forward(self, normalised: Tensor) -> Tensor:
        """(..., num_stacked * F), newest first, to (..., F + HIDDEN_SIZE)."""
        frames = normalised.reshape(-1, self.num_stacked, self.cell.input_size).unbind(1)
        state = frames[0].new_zeros(len(frames[0]), self.HIDDEN_SIZE)
        for frame in reversed(frames):
            state = self.cell(frame, state)
        encoded = torch.cat([frames[0], state], dim=-1)
        return encoded.reshape(*normalised.shape[:-1], encoded.shape[-1])


ENCODERS: dict[str, type[PlainEncoder] | type[GRUEncoder]] = {
    "none": PlainEncoder,
    "gru": GRUEncoder,
}


def make_encoder(name: str, features: Sequence[str]) -> PlainEncoder | GRUEncoder:
    """The encoder of that name.

    Args:
        name: "none" or "gru".
        features: names of the observation's columns.

    Raises:
        ValueError: the name is unknown, or the columns do not fit.
    """
    if name not in ENCODERS:
        raise ValueError(f"unknown encoder {name!r}, allowed: {', '.join(ENCODERS)}")
    return ENCODERS[name](features)
