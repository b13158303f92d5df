"""Launches of a kernel with the same arguments again and again, and numba-cuda's private names.

Numba-cuda looks at every argument at every launch, which takes as long as the step of thousands of
roads. So the arguments are turned into the kernel's numbers once. Without a private name used here
the results are the same, but each launch takes longer.
"""

import warnings
from collections.abc import Callable
from typing import Any

from numba import cuda

Kernel = Any
"""A function with ``cuda.jit``."""


Block = tuple[int, ...]
"""Threads of a block along its dimensions; along the last one each has work of its own."""


def configure(kernel: Kernel, number: int, block: Block, handle: int) -> Callable[..., None]:
    """The kernel on a stream, in as many blocks as ``number`` pieces of work take."""
    stream = cuda.external_stream(handle) if handle else cuda.default_stream()
    with warnings.catch_warnings():
        # A few roads leave most of a GPU idle.
        warnings.simplefilter("ignore")
        launch: Callable[..., None] = kernel[_count_blocks(number, block), block, stream]
    return launch


class Launch:
    """A kernel with its arguments, which stay where they are.

    Args:
        kernel: compiled at the first launch.
        number: pieces of work.
        arguments: arrays on the GPU, and numbers.
        block: its shape.
    """

    def __init__(
        self, kernel: Kernel, number: int, arguments: tuple[Any, ...], block: Block
    ) -> None:
        self._kernel, self._number, self._block = kernel, number, block
        self._arguments = arguments
        self._prepared: dict[int, Callable[[], None]] = {}

    def __call__(self, handle: int) -> None:
        """Launch it on the stream with this handle, 0 for the default one."""
        prepared = self._prepared.get(handle)
        if prepared is None:
            usual = configure(self._kernel, self._number, self._block, handle)
            # This compiles it.
            usual(*self._arguments)
            blocks = _count_blocks(self._number, self._block)
            prepared = _prepare(self._kernel, self._arguments, blocks, self._block, handle)
            self._prepared[handle] = prepared or (lambda: usual(*self._arguments))
            return
        prepared()


def _count_blocks(number: int, block: Block) -> int:
    return -(-number // block[-1])


def _prepare(
    kernel: Kernel, arguments: tuple[Any, ...], blocks: int, block: Block, handle: int
) -> Callable[[], None] | None:
    """The launch without a look at the arguments; None if this version of numba-cuda is unknown."""
    try:
        from cuda.core import LaunchConfig, Stream, launch

        compiled = kernel.compile(tuple(kernel.typeof_pyval(one) for one in arguments))
        numbers: list[Any] = []
        for kind, argument in zip(compiled.argument_types, arguments, strict=True):
            compiled._prepare_args(kind, argument, 0, [], numbers)
        function = compiled._codelibrary.get_cufunc().kernel
        stream = Stream.from_handle(handle)
    except (AttributeError, ImportError):
        return None
    config = LaunchConfig(grid=blocks, block=block)
    return lambda: launch(stream, config, function, *numbers)
