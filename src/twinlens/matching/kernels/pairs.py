"""Two image rows at once: the one that enters the window and the one that leaves it, byte beside byte in one number.

A box sum that slides down gains one row and loses another. Where pixels are bytes, both fit one 16-bit number, and one
instruction of many processors takes the leaving row's term from the entering row's: `slide_products` for products,
`distance_pairs` for absolute differences.
"""

# numba types what it compiles by itself; its decorators and the functions given to it carry no annotations
# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-any-return, misc"

from typing import Any

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.extending import intrinsic, overload

from twinlens.matching.kernels.compiling import jit
from twinlens.matching.kernels.dots import INT16, PART, cut, dot_onto, has, joined
from twinlens.matching.kernels.lanes import Lanes, call_intrinsic, load_of, splat_of, store_to

BYTE = ir.IntType(8)
PAIRED = ("product8", "absolute8")


@intrinsic
def slide_products(
    _typing: Any, window: Any, columns: Any, enters: Any, leaves: Any, pairs: Any, at: Any, factors: Any
) -> Any:
    """slide_products(window, columns, enters, leaves, pairs, at, factors): the window one step further right.

    To the column sums from columns[enters] on it adds pairs[2 i] * low half of factors + pairs[2 i + 1] * its high
    half, of the pairs from pairs[2 at] on; the window gains what this makes and loses the sums from columns[leaves] on.
    Sums are int32, pairs are bytes, factors is one int32 of two signed halves.
    Some lanes after others: LLVM keeps the order it is given, and all at once would not fit the registers.
    """

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        n, kinds = min(PART, window.n), signature.args
        words = ir.VectorType(INT16, 2 * n)
        both, parts = builder.bitcast(splat_of(builder, args[6], n), words), []
        for first in range(0, window.n, n):
            enter, leave, pair = (builder.add(args[i], ir.Constant(args[i].type, first)) for i in (2, 3, 5))
            doubled = builder.add(pair, pair)
            terms = builder.zext(load_of(context, builder, kinds[4], args[4], doubled, 2 * n), words)
            column = load_of(context, builder, kinds[1], args[1], enter, n)
            column = dot_onto(context, builder, column, terms, both)
            store_to(context, builder, kinds[1], args[1], enter, column)
            change = builder.sub(column, load_of(context, builder, kinds[1], args[1], leave, n))
            parts.append(builder.add(cut(builder, args[0], first, n), change))
        return joined(builder, parts)

    return window(window, columns, types.intp, types.intp, pairs, types.intp, types.int32), generate


def _differences(context: Any, builder: Any, values: Any) -> Any:
    """values[2 i] - values[2 i + 1] of bytes, in 16 bits."""
    count = values.type.count
    words = ir.VectorType(INT16, count // 2)
    room = 512 // 8
    if not has(context, "avx512bw") or count % room:
        both = builder.bitcast(values, words)
        low = builder.and_(both, ir.Constant(words, [255] * (count // 2)))
        return builder.sub(low, builder.lshr(both, ir.Constant(words, [8] * (count // 2))))
    signs = ir.Constant(ir.VectorType(BYTE, room), [1, -1] * (room // 2))
    half = ir.VectorType(INT16, room // 2)
    cuts = [[cut(builder, values, first, room), signs] for first in range(0, count, room)]
    return joined(builder, [call_intrinsic(builder, "llvm.x86.avx512.pmaddubs.w.512", half, cut) for cut in cuts])


@intrinsic
def distance_pairs(_typing: Any, pairs: Any, both: Any) -> Any:
    """distance_pairs(pairs, both): |pairs[2 i] - low byte of both| - |pairs[2 i + 1] - its second byte|, in uint16.

    pairs are bytes, both is one int32.
    """
    n = pairs.n // 2
    result = Lanes(types.uint16, n)

    def generate(context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        mine = builder.bitcast(splat_of(builder, builder.trunc(args[1], INT16), n), args[0].type)
        high = call_intrinsic(builder, f"llvm.umax.{pairs.suffix}", mine.type, [mine, args[0]])
        low = call_intrinsic(builder, f"llvm.umin.{pairs.suffix}", mine.type, [mine, args[0]])
        return _differences(context, builder, builder.sub(high, low))

    return result(pairs, types.int32), generate


def with_both_terms(kind: str, total: Any, pairs: Any, both: Any) -> Any:
    """total, more by the terms of the row that enters and less by those of the row that leaves, from `weave`d pairs.

    `both` is what `weave_left` made of the left image's two pixels. Only lanes and scalars are handed over here: an
    array would have its references counted at every pixel.
    """


@overload(with_both_terms, prefer_literal=True, inline="always", strict=False)
def _with_both_terms(kind: Any, total: Any, pairs: Any, both: Any) -> Any:
    if not isinstance(kind, types.StringLiteral):
        return None
    return {
        "absolute8": lambda kind, total, pairs, both: total + distance_pairs(pairs, both),
    }.get(kind.literal_value, lambda kind, total, pairs, both: total)


@jit
def weave_right(new, old, there, pairs):
    """pairs (2 W) bytes: those of the row that enters and of the one that leaves, in turns; `there`: does one leave?"""
    for i in range(len(new)):
        pairs[2 * i] = new[i]
        pairs[2 * i + 1] = old[i] if there else 0


@jit
def weave_left(new, old, there, signed, both):
    """both (W) int32: low half new, and above it -old; unsigned bytes stand side by side."""
    for i in range(len(new)):
        a, b = np.int32(new[i]), np.int32(old[i] if there else 0)
        both[i] = a | (-b << 16) if signed else a | (b << 8)
