"""The threads that advance a road together: on a GPU a team of up to 32, on the CPU one.

What the vehicles or agents of a road do by themselves, the members share out:

    for rank in range(member(), count, team_size()):
        ...

What is done in order, the first member does. Between what a member writes and what another one
reads of it, all ``meet``. Each member must come to each ``meet``, ``any_member``, ``least`` and
``most``: a branch around them must depend on what all members see alike.

On the CPU these are constants, and the compiler leaves out what is for several members. On a GPU
the first dimension of a block is a team: a power of two, so that it is within one group of 32.
"""

from collections.abc import Callable
from typing import Any, cast

import numba
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

from marl_lanes.traffic.machine.compiled import internal

MOST_MEMBERS = 32
"""Threads of a GPU that have one instruction at a time, and can meet without the others."""

TEAM_SIZES = (1, 2, 4, 8, 16, MOST_MEMBERS)
"""What a team may be: a part of them that they divide into."""

_BIT, _WORD, _LONG = ir.IntType(1), ir.IntType(32), ir.IntType(64)
_NOTHING = ir.Constant(ir.IntType(8).as_pointer(), None)
_ANSWER = ir.LiteralStructType((_WORD, _BIT))
_ANY, _EXCHANGE = _WORD(1), _WORD(3)
"""Modes of voting and of shuffling."""


def _call(builder: Any, name: str, result: Any, *arguments: Any) -> Any:
    kind = ir.FunctionType(result, [argument.type for argument in arguments])
    find = cast("Any", cgutils).get_or_insert_function
    return builder.call(find(builder.module, kind, f"llvm.nvvm.{name}"), arguments)


def _register(builder: Any, name: str) -> Any:
    return _call(builder, f"read.ptx.sreg.{name}", _WORD)


def _bits(builder: Any) -> Any:
    """The threads of the team within their group, a bit for each."""
    # What meets must neither be moved into a branch nor doubled, nor must a function that does.
    builder.function.attributes.add("convergent")
    size = _register(builder, "ntid.x")
    bits = builder.lshr(_WORD(0xFFFFFFFF), builder.sub(_WORD(MOST_MEMBERS), size))
    return builder.shl(bits, builder.and_(_register(builder, "laneid"), builder.neg(size)))


def _tell_member(builder: Any) -> Any:
    return builder.zext(_register(builder, "tid.x"), _LONG)


def _tell_size(builder: Any) -> Any:
    return builder.zext(_register(builder, "ntid.x"), _LONG)


def _wait(builder: Any) -> Any:
    _call(builder, "bar.warp.sync", ir.VoidType(), _bits(builder))
    return _NOTHING


def _vote(builder: Any, flag: Any) -> Any:
    _wait(builder)
    answer = _call(builder, "vote.sync", _ANSWER, _bits(builder), _ANY, flag)
    return builder.extract_value(answer, 1)


def _exchange(builder: Any, value: Any, distance: Any) -> Any:
    bits, team = builder.bitcast(value, _LONG), _bits(builder)
    far, width = builder.trunc(distance, _WORD), _WORD(MOST_MEMBERS - 1)

    def of_other(word: Any) -> Any:
        answer = _call(builder, "shfl.sync.i32", _ANSWER, team, _EXCHANGE, word, far, width)
        return builder.zext(builder.extract_value(answer, 0), _LONG)

    low = of_other(builder.trunc(bits, _WORD))
    high = of_other(builder.trunc(builder.lshr(bits, _LONG(32)), _WORD))
    return builder.bitcast(builder.or_(low, builder.shl(high, _LONG(32))), value.type)


def _code(build: Callable[..., Any], alone: Callable[..., Any]) -> Callable[..., Any]:
    """A function's instructions: ``build`` makes those for a GPU, ``alone`` those for the CPU."""

    def generate(_: Any, builder: Any, __: Any, arguments: Any) -> Any:
        is_on_gpu = str(builder.module.triple).startswith("nvptx")
        return build(builder, *arguments) if is_on_gpu else alone(*arguments)

    return generate


def _compile_is_team(_: Any) -> Any:
    return types.boolean(), _code(lambda _: _BIT(1), lambda: _BIT(0))


def _compile_member(_: Any) -> Any:
    return types.intp(), _code(_tell_member, lambda: _LONG(0))


def _compile_team_size(_: Any) -> Any:
    return types.intp(), _code(_tell_size, lambda: _LONG(1))


def _compile_meet(_: Any) -> Any:
    return types.void(), _code(_wait, lambda: _NOTHING)


def _compile_any_member(_: Any, flag: Any) -> Any:
    return types.boolean(flag), _code(_vote, lambda flag: flag)


def _compile_of_other(_: Any, value: Any, distance: Any) -> Any:
    return value(value, distance), _code(_exchange, lambda value, _: value)


class Loner:
    """The only thread of a road."""

    is_team = False
    member = 0
    size = 1

    def gather(self, value: Any) -> list[Any]:
        """The values of all members, in their order, once all have come here."""
        return [value]


crew: Any = Loner()
"""Who advances a road where numba's compilation is switched off. Tests put several threads here."""

_is_compiled = not cast("Any", numba.config).DISABLE_JIT

is_team: Any = intrinsic(_compile_is_team) if _is_compiled else lambda: crew.is_team
"""``is_team() -> bool``: whether threads may share a road: on a GPU, also in a team of 1."""

member: Any = intrinsic(_compile_member) if _is_compiled else lambda: crew.member
"""``member() -> int``: the thread's number in its team, from 0."""

team_size: Any = intrinsic(_compile_team_size) if _is_compiled else lambda: crew.size
"""``team_size() -> int``: the number of members."""

meet: Any = intrinsic(_compile_meet) if _is_compiled else lambda: crew.gather(None)
"""``meet() -> None``: wait for all members, and see what they have written."""

any_member: Any = (
    intrinsic(_compile_any_member) if _is_compiled else lambda flag: any(crew.gather(flag))
)
"""``any_member(flag: bool) -> bool``: whether the flag of a member is set; they meet for it."""

_of_other: Any = (
    intrinsic(_compile_of_other)
    if _is_compiled
    else lambda value, distance: crew.gather(value)[crew.member ^ distance]
)


@internal
def most(value: float) -> float:
    """The greatest value of all members."""
    distance = team_size() >> 1
    while distance > 0:
        value = max(value, _of_other(value, distance))
        distance >>= 1
    return value


@internal
def least(value: float) -> float:
    """The least value of all members."""
    return -most(-value)
