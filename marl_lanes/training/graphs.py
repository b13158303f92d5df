"""On a GPU a function becomes a CUDA graph: its kernels start together, without Python between."""

from collections import defaultdict
from collections.abc import Callable, Iterable
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor

from marl_lanes.starting import uncollected

NUM_WARMUPS = 3
"""Calls before the capture, in which torch allocates and compiles what it needs."""

Function = Callable[[TensorDictBase], TensorDictBase]


def is_capturing() -> bool:
    """Whether a capture is under way."""
    return torch.cuda.is_available() and torch.cuda.is_current_stream_capturing()


def capture(function: Callable[[], TensorDictBase]) -> Callable[[], TensorDictBase]:
    """Record the kernels of a function, without running them.

    Args:
        function: it waits for no result, and its tensors stay where they are.

    Returns:
        runs the kernels, and returns the tensors that they have written.
    """
    graph = torch.cuda.CUDAGraph()
    # What a collection frees on the GPU would end the capture.
    with uncollected(), torch.cuda.graph(graph):
        result = function()

    def replay() -> TensorDictBase:
        graph.replay()
        return result

    return replay


class Graphed:
    """A function that is captured after some calls, and from then on replayed.

    All calls are real, the first ones, too. Replayed it gives what it gives when it is called, bit
    for bit, and draws the same random numbers: a run that is resumed, and captures anew, goes on
    as if it had not been interrupted.

    tensordict's `CudaGraphModule` does as much, but waits for the GPU at every call.

    Args:
        function: of a tensordict that it may write to, with a result in tensors of its own. It
            must do the same whenever it is called: what is chosen in Python is chosen for ever.
        keys: of what it reads, where they are there; None: all.
    """

    def __init__(self, function: Function, keys: Iterable[NestedKey] | None = None) -> None:
        self.function = function
        self.keys = None if keys is None else list(keys)
        self.num_calls = 0
        self._stream = torch.cuda.Stream() if torch.cuda.is_available() else None

    def __call__(self, given: TensorDictBase) -> TensorDictBase:
        """The result, in tensors that the next call overwrites.

        Args:
            given: always of the same form.
        """
        self.num_calls += 1
        if self.num_calls <= NUM_WARMUPS:
            return self._warm_up(self._select(given))
        if self.num_calls == NUM_WARMUPS + 1:
            self._capture(self._select(given))
        for keys, places in self._places.values():
            torch._foreach_copy_(places, [given.get(key) for key in keys])
        return self._replay()

    def _select(self, given: TensorDictBase) -> TensorDictBase:
        return given.copy() if self.keys is None else given.select(*self.keys, strict=False)

    def _capture(self, given: TensorDictBase) -> None:
        """Capture with a copy of the input, to which later ones are copied."""
        own = given.clone()
        self._places = defaultdict[torch.dtype, tuple[list[Any], list[Tensor]]](lambda: ([], []))
        # Those of a dtype go in one kernel.
        for key, place in own.items(True, True):
            keys, places = self._places[place.dtype]
            keys.append(key)
            places.append(place)
        self._replay = capture(lambda: self.function(own.copy()))

    def _warm_up(self, given: TensorDictBase) -> TensorDictBase:
        """A call on another stream: autograd remembers the streams that it has worked on."""
        if self._stream is None:
            return self.function(given)
        self._stream.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(self._stream):
            result = self.function(given)
        torch.cuda.current_stream().wait_stream(self._stream)
        return result
