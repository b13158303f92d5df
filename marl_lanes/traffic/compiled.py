"""One way of compiling for every kernel."""

import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core.registry import CPUDispatcher

from marl_lanes.starting import uncollected

Function = TypeVar("Function", bound=Callable[..., Any])


def _hash_sources() -> str:
    """A digest of every source file of the simulation."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


_SOURCES = _hash_sources()


def compiled(function: Function) -> Function:
    """Compile on first call, kept on disk; IEEE semantics, no GIL.

    Kernels allocate nothing and own no array, so they count no references: that would take half of
    their time. Division by zero gives inf and nan as in numpy. Without the GIL several threads
    advance disjoint roads; fast-math stays off, so the bytes do not depend on how a loop was
    vectorised.
    """
    return _compile(function)


class _Internal(CPUDispatcher):
    """A kernel without an entry from Python; calling it there would crash the interpreter."""

    def __call__(self, *_: Any, **__: Any) -> Any:
        raise TypeError(f"{self.py_func.__name__}() can be called by other kernels only")


def internal(function: Function) -> Function:
    """Like ``compiled``, for what only kernels call: without the costly entry from Python.

    It is inlined into its callers, which then look into the arrays once and not at every call.

    Raises:
        TypeError: when it is called from Python, unless numba's compilation is switched off.
    """
    dispatcher = _compile(function, no_cpython_wrapper=True, forceinline=True)
    if dispatcher is not function:
        cast("Any", dispatcher).__class__ = _Internal
    return dispatcher


def entry_point(kernel: Function, arguments: Sequence[Any]) -> Function:
    """The compiled code of ``kernel`` for arguments of exactly these types.

    Numba looks the types of all arguments up at every call, which takes longer than a time step of
    a road. Who calls this must never pass others: nothing checks them any more.
    """
    if not isinstance(kernel, CPUDispatcher):
        return kernel  # numba's compilation is switched off
    signature = tuple(cast("Any", numba).typeof(argument) for argument in arguments)
    with uncollected():
        kernel.compile(signature)
    return cast("Function", kernel.get_overload(signature))


def _compile(function: Function, **options: bool) -> Function:
    compile_ = cast("Any", numba.njit)
    options |= {"cache": True, "nogil": True, "no_cfunc_wrapper": True, "_nrt": False}
    dispatcher = compile_(function, error_model="numpy", **options)
    if dispatcher is not function:
        # Numba stamps a cached kernel with its own file alone, yet it holds the code of the
        # kernels that it calls: without this an edit of one file would leave the others stale.
        cache_file = dispatcher._cache._cache_file
        cache_file._source_stamp = (cache_file._source_stamp, _SOURCES)
    return cast("Function", dispatcher)
