"""Encoders: what the networks of V, M and mu see of the normalized observation."""

import re
from collections.abc import Callable, Sequence

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


class GridEncoder(nn.Module):
    """The features, and what a small convolution makes of the occupancy grid.

    Two layers move along the road; the first one reads all lanes at once.

    Args:
        features: names of the observation's columns: those of the features, then for each cell
            ``occupied_LANE_STRETCH``, then for each ``cell_speed_LANE_STRETCH``.

    Attributes:
        outputs: names of the columns that it gives, those of the features first.

    Raises:
        ValueError: the columns do not end with those of a grid, or it has too few stretches.
    """

    NUM_CHANNELS = 8
    WIDTH = 5
    """[stretches] That a layer reads at once, at every second place."""
    LEAST_STRETCHES = 13

    def __init__(self, features: Sequence[str]) -> None:
        super().__init__()
        lanes, stretches = _grid_size(features)
        cells = [f"{i}_{j}" for i in range(lanes) for j in range(stretches)]
        columns = [f"{kind}_{cell}" for kind in ("occupied", "cell_speed") for cell in cells]
        self.num_features = len(features) - len(columns)
        if stretches < self.LEAST_STRETCHES or list(features[self.num_features :]) != columns:
            raise ValueError(
                f"encoder 'grid' needs an occupancy grid of {self.LEAST_STRETCHES} or more "
                f"stretches, not stacked, got {', '.join(features)}"
            )
        self.shape = (2, lanes, stretches)
        channels, width = self.NUM_CHANNELS, self.WIDTH
        self.layers = nn.Sequential(
            nn.Conv2d(2, channels, (lanes, width), stride=(1, 2), dtype=torch.float32),
            nn.Tanh(),
            nn.Conv2d(channels, channels, (1, width), stride=(1, 2), dtype=torch.float32),
            nn.Tanh(),
            nn.Flatten(),
        )
        size = self.layers(torch.zeros(1, *self.shape)).shape[1]
        self.outputs = [*features[: self.num_features], *(f"grid_{i}" for i in range(size))]

    def forward(self, normalised: Tensor) -> Tensor:
        """(..., F + 2 * lanes * stretches) to (..., F + the convolution's outputs)."""
        rows = normalised.reshape(-1, normalised.shape[-1])
        plain, cells = rows[:, : self.num_features], rows[:, self.num_features :]
        seen = self.layers(cells.reshape(-1, *self.shape))
        encoded = torch.cat([plain, seen], dim=-1)
        return encoded.reshape(*normalised.shape[:-1], encoded.shape[-1])


def _grid_size(features: Sequence[str]) -> tuple[int, int]:
    """Lanes and stretches of the grid whose last cell the last column names; (0, 0) for none."""
    found = re.fullmatch(r"cell_speed_(\d{1,2})_(\d{1,2})", "".join(features[-1:]))
    return (0, 0) if found is None else (int(found[1]) + 1, int(found[2]) + 1)


Encoder = PlainEncoder | GRUEncoder | GridEncoder

ENCODERS: dict[str, Callable[[Sequence[str]], Encoder]] = {
    "none": PlainEncoder,
    "gru": GRUEncoder,
    "grid": GridEncoder,
}


def make_encoder(name: str, features: Sequence[str]) -> Encoder:
    """The encoder of that name.

    Args:
        name: "none", "gru" or "grid".
        features: names of the observation's columns.

    Raises:
        ValueError: the name is unknown, or the columns do not fit.
    """
    if name not in ENCODERS:
        raise ValueError(f"unknown encoder {name!r}, allowed: {', '.join(ENCODERS)}")
    return ENCODERS[name](features)
