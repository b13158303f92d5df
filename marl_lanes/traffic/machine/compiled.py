"""One way of compiling for every kernel."""

import hashlib
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numba.core import types
from numba.core.registry import CPUDispatcher

from marl_lanes.starting import uncollected

Function = TypeVar("Function", bound=Callable[..., Any])


def _hash_sources() -> str:
    """A digest of every source file of the simulation."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parents[1].rglob("*.py")):
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
    dispatcher = _jit(function, cache=True)
    if dispatcher is not function:
        # Numba stamps a cached kernel with its own file alone, yet it holds the code of the
        # kernels that it calls: without this an edit of one file would leave the others stale.
        cache_file = cast("Any", dispatcher)._cache._cache_file
        cache_file._source_stamp = (cache_file._source_stamp, _SOURCES)
    return dispatcher


class _Internal(CPUDispatcher):
    """A kernel without an entry from Python; calling it there would crash the interpreter."""

    def __call__(self, *_: Any, **__: Any) -> Any:
        raise TypeError(f"{self.py_func.__name__}() can be called by other kernels only")


def internal(function: Function) -> Function:
    """Like ``compiled``, for what only kernels call: without the costly entry from Python.

    It is inlined into its callers, which then look into the arrays once and not at every call, and
    kept on disk with them alone.

    Raises:
        TypeError: when it is called from Python, unless numba's compilation is switched off.
    """
    dispatcher = _jit(function, no_cpython_wrapper=True, forceinline=True)
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
    signature = tuple(_type_of(argument) for argument in arguments)
    with uncollected(), _unused_scipy():
        kernel.compile(signature)
    return cast("Function", kernel.get_overload(signature))


def _type_of(argument: Any) -> Any:
    """Numba's type; of an array, which must be contiguous, without the import of ``numpy.ma``."""
    if not isinstance(argument, np.ndarray):
        return cast("Any", numba).typeof(argument)
    if not argument.flags.c_contiguous:
        raise ValueError("arrays of a kernel must be contiguous")
    return types.Array(cast("Any", numba).from_dtype(argument.dtype), argument.ndim, "C")


@contextmanager
def _unused_scipy() -> Iterator[None]:
    """Numba loads what it can compile without importing SciPy, which takes a fifth of a second.

    It imports it only to see whether linear algebra can be compiled; what compiles some still does.
    """
    linear_algebra = cast("Any", import_module("numba.np.linalg"))
    ensure_blas = getattr(linear_algebra, "ensure_blas", None)
    if ensure_blas is None or "numba.np.arraymath" in sys.modules:
        yield
        return

    def find_scipy() -> None:
        if find_spec("scipy") is None:
            raise ImportError("no scipy")

    linear_algebra.ensure_blas = find_scipy
    try:
        yield
    finally:
        linear_algebra.ensure_blas = ensure_blas


def _jit(function: Function, **options: bool) -> Function:
    compile_ = cast("Any", numba.njit)
    options |= {"nogil": True, "no_cfunc_wrapper": True, "_nrt": False}
    return cast("Function", compile_(function, error_model="numpy", **options))
