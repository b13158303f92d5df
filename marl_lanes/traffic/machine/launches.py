"""Kernels of a GPU: kept on disk, launched with the same arguments; numba-cuda's private names.

To compile a step for a GPU takes some twenty seconds: once, and not in every process. Numba-cuda
looks at every argument at every launch, which takes as long as the step of thousands of roads. So
the arguments are turned into the kernel's numbers once. Without a private name used here the
results are the same, but starting, or each launch, takes longer.
"""

import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import Any, cast

import numba
from numba import cuda
from numba.cuda import dispatcher

from marl_lanes.traffic.machine.numba_internals import Checked, Lenient, open_cache

Kernel = Any
"""A function with ``gpu_kernel``."""

# The classes of numba-cuda's cache, as in numba_internals.py.
_Cache: Any = getattr(dispatcher, "CUDACache", object)
_Content: Any = getattr(dispatcher, "CUDACacheImpl", object)
_MAKERS = (
    "llvmlite",
    "nvidia-nvvm",
    "nvidia-nvjitlink",
    "nvidia-cuda-nvcc-cu12",
    "nvidia-nvjitlink-cu12",
)
"""Packages that make machine code; the last two are those of CUDA 12."""

CAN_KEEP = hasattr(_Content, "rebuild") and hasattr(_Cache, "_impl_class")
"""Whether kernels of a GPU can be cached on disk."""

Block = tuple[int, ...]
"""Threads of a block along its dimensions; along the last one each has work of its own."""


@cache
def _find_makers() -> tuple[object, ...]:
    """What the code of a kernel depends on besides its sources."""
    config = cast("Any", numba.config)
    versions = []
    for name in _MAKERS:
        with suppress(PackageNotFoundError):
            versions.append((name, version(name)))
    return (*versions, str(config.OPT), config.CUDA_DEBUGINFO_DEFAULT)


class _CheckedContent(Checked, _Content):  # type: ignore[misc]
    """A kernel of a GPU, checked."""


class GpuKernelCache(Lenient, _Cache):  # type: ignore[misc]
    """Numba-cuda's cache of a kernel of a GPU.

    Numba-cuda's own key has neither the versions of CUDA's compiler and linker, nor the settings
    of the compiler that are in the environment.
    """

    _impl_class = _CheckedContent

    def _index_key(self, sig: Any, codegen: Any) -> tuple[Any, ...]:
        return (*super()._index_key(sig, codegen), *_find_makers())


def gpu_kernel(**options: Any) -> Callable[[Callable[..., None]], Kernel]:
    """Like ``cuda.jit``, for kernels: what is compiled at the first launch is kept on disk.

    Where, and when it is stale, is as for kernels of the CPU; and it is of one kind of GPU.
    """

    def make(function: Callable[..., None]) -> Kernel:
        kernel: Kernel = cuda.jit(**options)(function)
        if not cast("Any", numba.config).ENABLE_CUDASIM:
            kept = open_cache(GpuKernelCache, function, CAN_KEEP, "numba-cuda")
            if kept is not None:
                kernel._cache = kept
        return kernel

    return make


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
