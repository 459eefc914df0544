"""Four bytes in one number: what enters and what leaves a square window as it slides right, then down.

The sum of a term over the window's row that enters, less that over the row that leaves, changes by four terms for each
step to the right: the two rows' pixels at the window's right edge, and the two that its left edge lets go. Where the
terms are products of bytes, many processors add all four in one instruction.
"""

# numba types what it compiles by itself; its decorators and the functions given to it carry no annotations
# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-any-return, misc"

from typing import Any

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.extending import intrinsic

from twinlens.matching.kernels.compiling import inlined, jit
from twinlens.matching.kernels.dots import INT16, PART, ROOM, cut, dot_onto, has, joined
from twinlens.matching.kernels.lanes import INT32, Lanes, call_intrinsic, load_of, splat_of, store_to


@jit
def weave_quads(new, old, side, quads):
    """quads (W) uint32: the bytes new[i], old[i], new[i + side], old[i + side], lowest first; 0 past the row's end."""
    inner = max(len(new) - side, 0)
    new_ahead, old_ahead = new[side:], old[side:]
    for i in range(inner):
        low, high = np.uint32(new[i]) | np.uint32(old[i]) << 8, np.uint32(new_ahead[i]) | np.uint32(old_ahead[i]) << 8
        quads[i] = low | high << 16
    for i in range(inner, len(new)):
        quads[i] = np.uint32(new[i]) | np.uint32(old[i]) << 8


@inlined
def enters(pixel, centre):
    """The byte of pixel - centre, for a centre of 127 or 128; 127 for 128."""
    return (pixel - 128 if centre == 128 else pixel - 127 - (pixel == 255)) & 255


@inlined
def leaves(pixel, centre):
    """The byte of centre - pixel, for a centre of 127 or 128; 127 for 128."""
    return (128 - pixel - (pixel == 0) if centre == 128 else 127 - pixel) & 255


@jit
def weave_factors(new, old, there, side, centre, factors):
    """factors (W) int32: the signed bytes new[x] - c, c - old[x], c - new[x - side], old[x - side] - c, lowest first.

    Those of pixels before the row, and of `old` unless it is `there`, are 0. A byte holds -128 to 127, and the
    centre c is 127 or 128: what would be 128 is 127, and 1 in `weave_rests`.
    """
    begin = min(side, len(new))
    for x in range(begin):
        factors[x] = enters(new[x], centre) | (leaves(old[x], centre) << 8 if there else 0)
    ahead, new_ahead, old_ahead = factors[begin:], new[begin:], old[begin:]
    for x in range(len(new) - begin):
        of_new = enters(new_ahead[x], centre) | leaves(new[x], centre) << 16
        of_old = leaves(old_ahead[x], centre) << 8 | enters(old[x], centre) << 24
        ahead[x] = of_new | (of_old if there else 0)


@jit
def weave_rests(new, old, there, side, centre, rests):
    """rests (W) int32: the bytes by which those of `weave_factors` are too low, 0 or 1."""
    high, low = (255, -1) if centre == 127 else (-1, 0)
    for x in range(len(new)):
        a, b = np.int32(new[x] == high), np.int32(there and old[x] == low)
        rests[x] = a | b << 8
    begin = min(side, len(new))
    ahead = rests[begin:]
    for x in range(len(new) - begin):
        a, b = np.int32(new[x] == low), np.int32(there and old[x] == high)
        ahead[x] |= (a | b << 8) << 16


def _four_onto(context: Any, builder: Any, total: Any, quads: Any, factors: Any) -> Any:
    """total + the sum of four products, of unsigned bytes of `quads` and signed bytes of `factors`; all int32 lanes."""
    n = total.type.count
    if has(context, "avx512vnni") and n % ROOM == 0:
        name, part = "llvm.x86.avx512.vpdpbusd.512", ir.VectorType(INT32, ROOM)
        cuts = [[cut(builder, value, first, ROOM) for value in (total, quads, factors)] for first in range(0, n, ROOM)]
        return joined(builder, [call_intrinsic(builder, name, part, values) for values in cuts])
    words = ir.VectorType(INT16, 2 * n)
    bytes_of, eight = ir.Constant(words, [255] * (2 * n)), ir.Constant(words, [8] * (2 * n))
    pixels, weights = builder.bitcast(quads, words), builder.bitcast(factors, words)
    low = builder.and_(pixels, bytes_of), builder.ashr(builder.shl(weights, eight), eight)
    high = builder.lshr(pixels, eight), builder.ashr(weights, eight)
    return dot_onto(context, builder, dot_onto(context, builder, total, *low), *high)


@intrinsic
def slide_quads(_typing: Any, change: Any, quads: Any, at: Any, factors: Any, rests: Any) -> Any:
    """slide_quads(change, quads, at, factors, rests): the rows' sums one step further right, from `weave_quads`.

    To each of the int32 lanes it adds the four products of a number of `quads`, read from `at` on, with the one
    `factors`, and again with `rests` where that is not 0.
    """

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        def added(total: Any, weights: Any) -> Any:
            parts, n = [], min(PART, change.n)
            both = splat_of(builder, weights, n)
            for first in range(0, change.n, n):
                place = builder.add(args[2], ir.Constant(args[2].type, first))
                values = load_of(context, builder, signature.args[1], args[1], place, n)
                parts.append(_four_onto(context, builder, cut(builder, total, first, n), values, both))
            return joined(builder, parts)

        once = added(args[0], args[3])
        before = builder.basic_block
        with builder.if_then(builder.icmp_signed("!=", args[4], INT32(0)), likely=False):
            twice = added(once, args[4])
            inner = builder.basic_block
        result = builder.phi(once.type)
        result.add_incoming(once, before)
        result.add_incoming(twice, inner)
        return result

    return change(change, quads, types.intp, types.int32, types.int32), generate


@intrinsic
def gather_sums(_typing: Any, change: Any, sums: Any, at: Any, weight: Any) -> Any:
    """gather_sums(change, sums, at, weight): sums[at] and on, more by weight * change; kept there, and returned."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        parts, n = [], min(PART, change.n)
        weights = splat_of(builder, args[3], n)
        for first in range(0, change.n, n):
            place = builder.add(args[2], ir.Constant(args[2].type, first))
            more = builder.mul(cut(builder, args[0], first, n), weights)
            total = builder.add(load_of(context, builder, signature.args[1], args[1], place, n), more)
            store_to(context, builder, signature.args[1], args[1], place, total)
            parts.append(total)
        return joined(builder, parts)

    return change(change, sums, types.intp, types.int32), generate


@intrinsic
def similarities(_typing: Any, sums: Any, factor: Any, values: Any, scales: Any, at: Any) -> Any:
    """similarities(sums, factor, values, scales, at): the bits of (sums + factor * values) * scales in float32.

    values (uint16, up to 32767) and scales (float32) are read from `at` on; the factor fits 16 bits with its sign.
    As int32, the bits of positive numbers lie in their order, above those of all others.
    """
    result = Lanes(types.int32, sums.n)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        n = min(PART, sums.n)
        words, floats = ir.VectorType(INT16, 2 * n), ir.VectorType(ir.FloatType(), n)
        both, parts = builder.bitcast(splat_of(builder, args[1], n), words), []
        for first in range(0, sums.n, n):
            place = builder.add(args[4], ir.Constant(args[4].type, first))
            value = load_of(context, builder, signature.args[2], args[2], place, n)
            scale = load_of(context, builder, signature.args[3], args[3], place, n)
            total = cut(builder, args[0], first, n)
            wide = builder.bitcast(builder.zext(value, total.type), words)
            score = builder.fmul(builder.sitofp(dot_onto(context, builder, total, wide, both), floats), scale)
            parts.append(builder.bitcast(score, total.type))
        return joined(builder, parts)

    return result(sums, types.int32, values, scales, types.intp), generate
