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
from twinlens.matching.kernels.lanes import INT32, Lanes, call_intrinsic, load_of, splat_of, store_to

BYTE, INT16 = ir.IntType(8), ir.IntType(16)
PAIRED = ("product8", "absolute8")
PART = 64  # lanes at a time


def _deal(builder: Any, values: Any, first: int) -> Any:
    """Every second lane, from `first` on."""
    n = values.type.count // 2
    places = ir.Constant(ir.VectorType(INT32, n), list(range(first, 2 * n, 2)))
    return builder.shuffle_vector(values, ir.Constant(values.type, ir.Undefined), places)


def _has(context: Any, feature: str) -> bool:
    """Has the processor that is compiled for this LLVM feature?"""
    return f"+{feature}" in context.codegen().magic_tuple()[2].split(",")


def _cut(builder: Any, values: Any, first: int, n: int) -> Any:
    places = ir.Constant(ir.VectorType(INT32, n), list(range(first, first + n)))
    return builder.shuffle_vector(values, ir.Constant(values.type, ir.Undefined), places)


def _joined(builder: Any, parts: list[Any]) -> Any:
    """The vectors one after the other; a power of two of them."""
    while len(parts) > 1:
        size = 2 * parts[0].type.count
        places = ir.Constant(ir.VectorType(INT32, size), list(range(size)))
        parts = [builder.shuffle_vector(*parts[i : i + 2], places) for i in range(0, len(parts), 2)]
    return parts[0]


def _dot_onto(context: Any, builder: Any, total: Any, words: Any, factors: Any) -> Any:
    """total[i] + words[2 i] factors[2 i] + words[2 i + 1] factors[2 i + 1], of int16 into int32."""
    n, room = total.type.count, 512 // 32
    if _has(context, "avx512vnni") and n % room == 0:
        name, part = "llvm.x86.avx512.vpdpwssd.512", ir.VectorType(INT32, room)
        whole = [total, builder.bitcast(words, total.type), builder.bitcast(factors, total.type)]
        cuts = [[_cut(builder, value, first, room) for value in whole] for first in range(0, n, room)]
        return _joined(builder, [call_intrinsic(builder, name, part, cut) for cut in cuts])
    full = ir.VectorType(INT32, 2 * n)
    product = builder.mul(builder.sext(words, full), builder.sext(factors, full))
    # LLVM would add the halves to the total one by one and miss its match. The one fence it has is for floats.
    fenced = ir.VectorType(ir.FloatType(), n)
    dots = builder.bitcast(builder.add(_deal(builder, product, 0), _deal(builder, product, 1)), fenced)
    dots = builder.bitcast(call_intrinsic(builder, f"llvm.arithmetic.fence.v{n}f32", fenced, [dots]), total.type)
    return builder.add(total, dots)


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
            column = _dot_onto(context, builder, column, terms, both)
            store_to(context, builder, kinds[1], args[1], enter, column)
            change = builder.sub(column, load_of(context, builder, kinds[1], args[1], leave, n))
            parts.append(builder.add(_cut(builder, args[0], first, n), change))
        return _joined(builder, parts)

    return window(window, columns, types.intp, types.intp, pairs, types.intp, types.int32), generate


@intrinsic
def scored_product(_typing: Any, total: Any, factor: Any, values: Any, scales: Any, at: Any) -> Any:
    """scored_product(total, factor, values, scales, at): (total + factor * values) * scales, in the scales' dtype.

    values and scales are read from `at` on; total is int32, factor and values are whole numbers from 0 to 32767.
    Some lanes after others: LLVM keeps the order it is given, and all at once would not fit the registers.
    """
    result = Lanes(scales.dtype, total.n)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        totals, factor, _, _, at = args
        n = min(PART, total.n)
        words = ir.VectorType(INT16, 2 * n)
        both = builder.bitcast(splat_of(builder, factor, n), words)
        parts = []
        for first in range(0, total.n, n):
            place = builder.add(at, ir.Constant(at.type, first))
            value = load_of(context, builder, signature.args[2], args[2], place, n)
            scale = load_of(context, builder, signature.args[3], args[3], place, n)
            part = _cut(builder, totals, first, n)
            wide = builder.bitcast(builder.zext(value, part.type), words)
            parts.append(builder.fmul(builder.sitofp(_dot_onto(context, builder, part, wide, both), scale.type), scale))
        return _joined(builder, parts)

    return result(total, types.int32, values, scales, types.intp), generate


def _differences(context: Any, builder: Any, values: Any) -> Any:
    """values[2 i] - values[2 i + 1] of bytes, in 16 bits."""
    count = values.type.count
    words = ir.VectorType(INT16, count // 2)
    room = 512 // 8
    if not _has(context, "avx512bw") or count % room:
        both = builder.bitcast(values, words)
        low = builder.and_(both, ir.Constant(words, [255] * (count // 2)))
        return builder.sub(low, builder.lshr(both, ir.Constant(words, [8] * (count // 2))))
    signs = ir.Constant(ir.VectorType(BYTE, room), [1, -1] * (room // 2))
    half = ir.VectorType(INT16, room // 2)
    cuts = [[_cut(builder, values, first, room), signs] for first in range(0, count, room)]
    return _joined(builder, [call_intrinsic(builder, "llvm.x86.avx512.pmaddubs.w.512", half, cut) for cut in cuts])


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
def weave_left(new, old, there, gain, signed, both):
    """both (W) int32: low half gain * new, and above it -gain * old; unsigned bytes stand side by side."""
    for i in range(len(new)):
        a, b = np.int32(new[i]), np.int32(old[i] if there else 0)
        both[i] = ((gain * a) & 0xFFFF) | ((-gain * b) << 16) if signed else a | (b << 8)
