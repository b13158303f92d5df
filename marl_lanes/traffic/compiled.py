"""One way of compiling for every kernel."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """Compile on first call, kept on disk; IEEE semantics, no GIL.

    Division by zero gives inf and nan as in numpy. Without the GIL several threads advance
    disjoint roads; fast-math stays off, so the bytes do not depend on how a loop was vectorised.
    """
    return cast("Function", numba.njit(function, cache=True, nogil=True, error_model="numpy"))
