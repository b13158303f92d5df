"""Arrays in a GPU's memory: made, seen as words, and fetched."""

from typing import Any, Protocol

import numpy as np
from numba import cuda
from numpy.typing import NDArray

from marl_lanes.traffic.machine.state import State

DeviceArray = Any
"""An array of numba-cuda in the GPU's memory."""


class Fetching(Protocol):
    """Whose arrays are on a GPU."""

    tables: State

    def fetch(self, array: DeviceArray) -> NDArray[Any]:
        """A read-only copy of an array, after all work of the GPU."""


class FetchedState:
    """A ``State`` whose arrays are on a GPU: each access fetches a copy, which is read-only.

    It waits for the GPU, and takes as long as copying the array. A copy does not change later.
    """

    def __init__(self, roads: Fetching) -> None:
        self._roads = roads

    def __getattr__(self, name: str) -> NDArray[Any]:
        if name.startswith("_"):
            raise AttributeError(name)
        return self._roads.fetch(getattr(self._roads.tables, name))

    @property
    def arrays(self) -> tuple[NDArray[Any], ...]:
        """Copies of all arrays, in kernel order."""
        return tuple(map(self._roads.fetch, self._roads.tables.arrays))

    def tobytes(self) -> bytes:
        """Every byte of the state, for comparisons."""
        return b"".join(array.tobytes() for array in self.arrays)


def empty(shape: tuple[int, ...], dtype: Any) -> DeviceArray:
    """A new array on the present GPU."""
    return cuda.device_array(shape, dtype)


def words(array: Any) -> Any:
    """The same memory as (E, n) uint32."""
    flat = array.reshape(array.size).view(np.uint32)
    return flat.reshape(array.shape[0], flat.size // array.shape[0])
