"""On a GPU, the threads of a group take a rare branch together and not one after the other.

A group of 32 threads, which advance 32 roads, has one instruction at a time. Where a loop has a
common and a rare branch, the rare one would be taken in nearly every round, by a few threads, while
the others wait. So each thread first goes through the common ones up to its next rare one:

    while rank < count:
        converge()
        while rank < count and is_common(rank):
            ...
            rank += 1
        if rank < count:
            ...  # the rare branch, once for all threads
            rank += 1
"""

from typing import Any, cast

import numba
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic


def _meet(_: Any) -> Any:
    """Let the threads that arrive here go on together; nothing on the CPU.

    Without an instruction here the compiler would make one loop of the two.
    """

    def generate(context: Any, builder: Any, *_: Any) -> Any:
        if str(builder.module.triple).startswith("nvptx"):
            kind = ir.FunctionType(ir.VoidType(), [])
            code = "{ .reg .b32 group; activemask.b32 group; bar.warp.sync group; }"
            builder.call(ir.InlineAsm(kind, code, "", side_effect=True), [])
        return context.get_dummy_value()

    return types.void(), generate


def _nothing() -> None:
    """Do nothing, if numba's compilation is switched off."""


_is_compiled = not cast("Any", numba.config).DISABLE_JIT
converge: Any = intrinsic(_meet) if _is_compiled else _nothing
