"""One way of compiling for every kernel."""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numba.core import types
from numba.core.registry import CPUDispatcher

from marl_lanes.starting import uncollected
from marl_lanes.traffic.machine.numba_internals import (
    InternalKernel,
    Kernel,
    known_options,
    unused_scipy,
)

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """Compile on first call, kept on disk where that is possible; IEEE semantics, no GIL.

    Kernels allocate nothing and own no array, so they count no references: that would take half of
    their time. Division by zero gives inf and nan as in numpy. Without the GIL several threads
    advance disjoint roads; fast-math stays off, so the bytes do not depend on how a loop was
    vectorised.
    """
    kernel = _make(Kernel, function)
    if kernel is not function:
        cast("Any", kernel).enable_caching()
    return kernel


def internal(function: Function) -> Function:
    """Like ``compiled``, for what only kernels call: without the costly entry from Python.

    It is inlined into its callers, which then look into the arrays once and not at every call, and
    kept on disk with them alone.

    Raises:
        TypeError: when it is called from Python, unless numba's compilation is switched off.
    """
    return _make(InternalKernel, function, no_cpython_wrapper=True, forceinline=True)


def entry_point(kernel: Function, arguments: Sequence[Any]) -> Function:
    """The compiled code of ``kernel`` for arguments of exactly these types.

    Numba looks the types of all arguments up at every call, which takes longer than a time step of
    a road. Who calls this must never pass others: nothing checks them any more.
    """
    if not isinstance(kernel, CPUDispatcher):
        return kernel  # numba's compilation is switched off
    signature = tuple(_type_of(argument) for argument in arguments)
    with uncollected(), unused_scipy():
        kernel.compile(signature)
    return cast("Function", kernel.get_overload(signature))


def on_columns(kernel: Callable[..., Any]) -> Callable[..., Any]:
    """The kernel's own source, for whole columns of a table at once, by numpy.

    It must have no branch and call no other kernel. A table's fields are attributes in
    ``table.view(numpy.recarray)``.
    """
    return cast("Callable[..., Any]", getattr(kernel, "py_func", kernel))


def _type_of(argument: Any) -> Any:
    """Numba's type; of an array, which must be contiguous, without the import of ``numpy.ma``."""
    if not isinstance(argument, np.ndarray):
        return cast("Any", numba).typeof(argument)
    if not argument.flags.c_contiguous:
        raise ValueError("arrays of a kernel must be contiguous")
    return types.Array(cast("Any", numba).from_dtype(argument.dtype), argument.ndim, "C")


def _make(kind: type[CPUDispatcher], function: Function, **options: bool) -> Function:
    """What ``numba.njit`` makes, of another class."""
    if cast("Any", numba.config).DISABLE_JIT:
        return function
    saving = known_options(no_cfunc_wrapper=True, _nrt=False, **options)
    chosen = {"nopython": True, "boundscheck": None, "nogil": True, "error_model": "numpy"}
    return cast("Function", kind(function, targetoptions=chosen | saving))
