"""How all kernels are compiled."""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numba.core import types
from numba.core.registry import CPUDispatcher

from marl_lanes.starting import uncollected
from marl_lanes.traffic.machine.numba_internals import (
    NO_COUNTING,
    InternalKernel,
    Kernel,
    known_options,
    unused_scipy,
)

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """Compile on the first call, cache on disk if possible; IEEE semantics, no GIL.

    Kernels allocate nothing and own no array, so reference counting is off: it would take half of
    their time. Division by zero gives inf or nan as in numpy. Without the GIL several threads can
    advance disjoint roads. Fast-math is off, so the bytes do not depend on how a loop was
    vectorised.
    """
    kernel = _make(Kernel, function)
    if kernel is not function:
        cast("Any", kernel).enable_caching()
    return kernel


def internal(function: Function) -> Function:
    """Like ``compiled``, for functions that only kernels call: without an entry point from Python.

    That entry point is slow to compile. The function is inlined into its callers, which then unpack
    the arrays once and not at every call, and is cached on disk only as part of them.

    Raises:
        TypeError: it is called from Python, and numba's compilation is not switched off.
    """
    return _make(InternalKernel, function, no_cpython_wrapper=True, forceinline=True)


def entry_point(kernel: Function, arguments: Sequence[Any]) -> Function:
    """The compiled code of ``kernel`` for arguments of exactly these types.

    Numba looks up the types of all arguments at every call, which takes longer than a time step of
    a road. This code does not check them: never call it with arguments of other types.
    """
    if not isinstance(kernel, CPUDispatcher):
        return kernel  # numba's compilation is switched off
    signature = tuple(_type_of(argument) for argument in arguments)
    with uncollected(), unused_scipy():
        kernel.compile(signature)
    return cast("Function", kernel.get_overload(signature))


def on_columns(kernel: Callable[..., Any]) -> Callable[..., Any]:
    """The kernel's Python function, for whole columns of a table at once, with numpy.

    It must have no branch and call no other kernel. Pass a table as ``table.view(numpy.recarray)``,
    whose fields are attributes.
    """
    return cast("Callable[..., Any]", getattr(kernel, "py_func", kernel))


def _type_of(argument: Any) -> Any:
    """Numba's type, without importing ``numpy.ma`` for an array; arrays must be contiguous."""
    if not isinstance(argument, np.ndarray):
        return cast("Any", numba).typeof(argument)
    if not argument.flags.c_contiguous:
        raise ValueError("arrays of a kernel must be contiguous")
    return types.Array(cast("Any", numba).from_dtype(argument.dtype), argument.ndim, "C")


def _make(kind: type[CPUDispatcher], function: Function, **options: bool) -> Function:
    """Like ``numba.njit``, with a dispatcher of another class."""
    if cast("Any", numba.config).DISABLE_JIT:
        return function
    saving = known_options(no_cfunc_wrapper=True, **NO_COUNTING, **options)
    chosen = {"nopython": True, "boundscheck": None, "nogil": True, "error_model": "numpy"}
    return cast("Function", kind(function, targetoptions=chosen | saving))
