"""Load the next road's records into the processor's cache while this road advances."""

from typing import Any, cast

import numba
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

from marl_lanes.traffic.machine.compiled import internal

_LINE = 64
"""[bytes] Size of a cache line."""


def _hint(_: Any, array: Any, row: Any, offset: Any) -> Any:  # noqa: ARG001 - numba reads them
    """Tell the processor that the byte ``offset`` of ``array[row]`` is needed soon."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        if str(builder.module.triple).startswith("nvptx"):
            return context.get_dummy_value()  # the roads of a GPU advance side by side
        tools = cast("Any", cgutils)
        kind = signature.args[0]
        view = context.make_array(kind)(context, builder, arguments[0])
        stride = tools.unpack_tuple(builder, view.strides, kind.ndim)[0]
        byte = builder.add(builder.mul(arguments[1], stride), arguments[2])
        base = builder.bitcast(view.data, ir.IntType(8).as_pointer())
        flag = ir.IntType(32)
        hint = ir.FunctionType(ir.VoidType(), [base.type, flag, flag, flag])
        function = tools.get_or_insert_function(builder.module, hint, "llvm.prefetch.p0")
        # For reading, into every level of the cache, data and not code.
        flags = [flag(0), flag(3), flag(1)]
        builder.call(function, [builder.gep(base, [byte]), *flags])
        return context.get_dummy_value()

    return types.void(array, types.intp, types.intp), generate


def _nothing(_array: Any, _row: int, _offset: int) -> None:
    """Do nothing, if numba's compilation is switched off."""


_is_compiled = not cast("Any", numba.config).DISABLE_JIT
_prefetch_line: Any = intrinsic(_hint) if _is_compiled else _nothing


@internal
def prefetch(array: Any, row: int, start: int, num_bytes: int) -> None:
    """Prefetch ``num_bytes`` of ``array[row]`` from ``start`` on; the row need not exist.

    It changes only the speed. The processor fetches about ten cache lines at a time and then waits,
    so a few lines at a time cost less than many at once.
    """
    for offset in range(0, num_bytes, _LINE):
        _prefetch_line(array, row, start + offset)
