"""Winner-take-all with one square window: every measure that is a box sum of a pixel term, in O(W D) memory.

For each image row, the sum of a term over a column of the window is kept for every x and candidate; stepping a row
down adds the term below and takes the term above away. Sliding right along the row, the window's sum gains the column
that enters and loses the one that leaves. Both steps act on all candidates at once (`lanes`); the right image lies
reversed in memory so that growing disparity reads forward. The winner is found in registers.

The layout that the caller prepares (`matching.box`): `left` is padded by the radius on each side; `right` is padded
and reversed such that lane j of the padded column x is right[row, start - x + j]. Both flat, with their row strides.
"""

# numba types what it compiles by itself; its decorators and the functions given to it carry no annotations
# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-any-return, misc"

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import types
from numba.extending import overload

from twinlens.matching.kernels.compiling import inlined, jit
from twinlens.matching.kernels.lanes import (
    convert,
    distance,
    dot_pairs,
    first_equal,
    inside,
    larger,
    load,
    lowest,
    ones,
    splat,
    store,
    width_of,
)

NO_FIT, V_FIT, PARABOLA_FIT = 0, 1, 2


def term(kind: str, a: Any, b: Any, like: Any) -> Any:
    """The pixel term of a measure, in the dtype of `like`: what the window's box sum adds up."""


@overload(term, prefer_literal=True, inline="always", strict=False)
def _term(kind: Any, a: Any, b: Any, like: Any) -> Any:
    if not isinstance(kind, types.StringLiteral):
        return None
    return {
        "absolute": lambda kind, a, b, like: convert(distance(a, b), like),
        "square": lambda kind, a, b, like: convert(distance(a, b), like) * convert(distance(a, b), like),
        "product": lambda kind, a, b, like: convert(a, like) * convert(b, like),
        "product8": lambda kind, a, b, like: like,
        "hamming": lambda kind, a, b, like: convert(ones(a ^ b), like),
    }[kind.literal_value]


def both_terms(kind: str, pairs: Any, both: Any, like: Any) -> Any:
    """For "product8": the products of the row that enters less those of the row that leaves, from `interleave`d pairs.

    `both` is the left image's pixel of the one row, and in the upper half of the number, negative, that of the other.
    Only lanes and scalars are handed over here: an array would have its references counted at every pixel.
    """


@overload(both_terms, prefer_literal=True, inline="always", strict=False)
def _both_terms(kind: Any, pairs: Any, both: Any, like: Any) -> Any:
    if not isinstance(kind, types.StringLiteral):
        return None
    if kind.literal_value == "product8":
        return lambda kind, pairs, both, like: dot_pairs(convert(pairs, splat(np.int16(0), pairs)), np.int32(both))
    return lambda kind, pairs, both, like: like


def interleave(kind: str, right: Any, pairs: Any, entering: int, leaving: int) -> None:
    """Fill `pairs` with the row of the right image that enters and the one that leaves (-1: none does)."""


@overload(interleave, prefer_literal=True, strict=False)
def _interleave(kind: Any, right: Any, pairs: Any, entering: Any, leaving: Any) -> Any:
    if not isinstance(kind, types.StringLiteral):
        return None

    def nothing(kind, right, pairs, entering, leaving):
        return None

    def weave(kind, right, pairs, entering, leaving):
        words = pairs.view(np.uint16)
        new, old = right[entering : entering + len(words)], right[leaving : leaving + len(words)]
        for i in range(len(words)):
            words[i] = new[i]
        if leaving >= 0:
            for i in range(len(words)):
                words[i] |= np.uint16(old[i]) << np.uint16(8)

    return weave if kind.literal_value == "product8" else nothing


def score(kind: str, window: Any, area: Any, lefts: Any, pixel: int, rights: Any, at: int, like: Any) -> Any:
    """A measure, lower is better, from the window's sum and the two windows' own statistics.

    `lefts` and `rights` are pairs of flat arrays: the windows' sums, and their scales in the dtype of `like`; the
    left ones are read at `pixel`, the right ones, reversed, from `at` on.
    """


@overload(score, prefer_literal=True, inline="always", strict=False)
def _score(kind: Any, window: Any, area: Any, lefts: Any, pixel: Any, rights: Any, at: Any, like: Any) -> Any:
    if not isinstance(kind, types.StringLiteral):
        return None
    n = window.n

    def total(kind, window, area, lefts, pixel, rights, at, like):
        return window

    def zncc(kind, window, area, lefts, pixel, rights, at, like):
        covariance = (
            splat(lefts[0][pixel], window) * load(rights[0], at, n) - convert(splat(area, window), window) * window
        )
        return convert(covariance, like) * (load(rights[1], at, n) * splat(lefts[1][pixel], like))

    def zncc_of_right(kind, window, area, lefts, pixel, rights, at, like):
        # The left window's scale is the same for all candidates: whole numbers choose the same winner without it.
        covariance = splat(lefts[0][pixel], window) * load(rights[0], at, n)
        return convert(covariance - convert(splat(area, window), window) * window, like) * load(rights[1], at, n)

    def zncc_of_weighted(kind, window, area, lefts, pixel, rights, at, like):
        # The left image came with the area in it.
        covariance = splat(lefts[0][pixel], window) * load(rights[0], at, n) - window
        return convert(covariance, like) * load(rights[1], at, n)

    def ncc(kind, window, area, lefts, pixel, rights, at, like):
        return convert(window, like) * (load(rights[1], at, n) * splat(-lefts[1][pixel], like))

    def zssd(kind, window, area, lefts, pixel, rights, at, like):
        offset = splat(lefts[0][pixel], window) - load(rights[0], at, n)
        return convert(splat(area, window), window) * window - offset * offset

    def jaccard(kind, window, area, lefts, pixel, rights, at, like):
        sad = convert(window, like)
        union = splat(lefts[1][pixel], like) + load(rights[1], at, n) + sad
        return (sad + sad) / larger(union, splat(tiny(like), like))

    scorings = zncc, zncc_of_right, zncc_of_weighted, ncc, zssd, jaccard
    return {"sum": total, **{function.__name__: function for function in scorings}}[kind.literal_value]


def tiny(like: Any) -> Any:
    """The smallest normal number of the lanes' dtype: what a denominator of zero becomes."""


@overload(tiny, inline="always", strict=False)
def _tiny(like: Any) -> Any:
    smallest = np.finfo(str(like.dtype)).tiny
    return lambda like: smallest


@inlined
def fitted(fit: int, before: Any, here: Any, after: Any) -> float:
    """Offset of the minimum, in [-0.5, 0.5] pixels, from the costs at d - 1, d and d + 1.

    V: two lines of equal and opposite slope, (before - after) / (2 (max(before, after) - here)); its truth is an
    absolute difference. Parabola: (before - after) / (2 (before - 2 here + after)); its truth is a square.
    Shimizu and Okutomi, "Sub-pixel estimation error cancellation on area-based matching", IJCV 2005.
    """
    a, c, b = np.float64(before), np.float64(here), np.float64(after)
    bend = 2.0 * (max(a, b) - c) if fit == V_FIT else 2.0 * (a - 2.0 * c + b)
    return (a - b) / bend if fit != NO_FIT and bend > 0.0 else 0.0


@inlined
def winner(cost, begin, end, bar):
    """(lowest cost, its lane) among lanes begin..end; lane -1 if none is below `bar`."""
    own = inside(cost, begin, end, bar) if begin > 0 or end < width_of(cost) else cost
    value = lowest(own)
    k = first_equal(own, value) if value < bar else -1
    return value, k


@inlined
def rival(cost, begin, end, k, bar):
    """The lowest cost, or `bar` if that is lower, among lanes begin..end that are not the winner k or next to it."""
    below = inside(cost, begin, min(max(k - 1, 0), end), bar)
    above = inside(cost, max(min(k + 2, end), begin), end, bar)
    return min(lowest(below), lowest(above))


WINNERS, RIVALS, VOLUME, WHOLE = 0, 1, 2, 3


@functools.cache
def slide_kernel(kind: str, scoring: str, n: int, mode: int) -> Callable[..., None]:
    """The kernel for one pixel term, one scoring and n lanes.

    WINNERS fills best and disparity, (H, W), with the lowest cost and where it lies. RIVALS is given the winners in
    `disparity` and lowers `best` to the cost of the best candidate at least two away. VOLUME writes every candidate's
    cost * gain + offset to the flat `volume`, (H, W, depth), at the candidates from `place` on; candidates that do not
    exist get `blank` where `masked` is set, otherwise what the edge-continued images give. WHOLE is VOLUME for whole
    numbers that the volume holds as they are.
    `spans` is (radius, area, disparity of lane 0, low, high, begin, end): lanes low..high lie in the requested range,
    lanes begin..end may win in this pass. `target` is (depth, place, masked), `values` is (gain, offset, blank).
    """

    paired, twice = kind == "product8", 2 * n

    @jit
    def slide(
        left, right, layout, lefts, rights, spans, fit, columns, pairs, costs, best, disparity, volume, target, values
    ):
        height, width = best.shape
        left_stride, right_stride, right_start, stat_stride, stat_start = layout
        radius, area, first, low, high, own_begin, own_end = spans
        side = 2 * radius + 1
        zero = load(columns, 0, n)
        like = splat(best[0, 0], zero)
        real = splat(values[0], zero)
        out = splat(volume[0], zero)
        for y in range(1 - side, height):
            window = zero
            row = y + side - 1
            interleave(kind, right, pairs, row * right_stride, (y - 1) * right_stride if y > 0 else -1)
            for x in range(width + 2 * radius):
                column = load(columns, (x + side) * n, n)
                if paired:
                    both = np.int32(left[row * left_stride + x])
                    if y > 0:
                        both -= np.int32(left[(y - 1) * left_stride + x]) << 16
                    column = column + both_terms(kind, load(pairs, 2 * (right_start - x), twice), both, zero)
                else:
                    a = splat(left[row * left_stride + x], zero)
                    column = column + term(kind, a, load(right, row * right_stride + right_start - x, n), zero)
                    if y > 0:
                        a = splat(left[(y - 1) * left_stride + x], zero)
                        b = load(right, (y - 1) * right_stride + right_start - x, n)
                        column = column - term(kind, a, b, zero)
                store(columns, (x + side) * n, column)
                window = window + (column - load(columns, x * n, n))
                u = x - 2 * radius
                start, stop = max(low, u - first - width + 1, 0), min(high, u - first + 1, n)
                begin, end = max(start, own_begin), min(stop, own_end)
                if y < 0 or u < 0 or (begin >= end and mode < VOLUME):
                    continue
                at = y * stat_stride + stat_start - u
                cost = score(scoring, window, area, lefts, y * width + u, rights, at, like)
                if mode == RIVALS:
                    k = int(np.ceil(disparity[y, u] - 0.5)) - first
                    best[y, u] = rival(cost, begin, end, k, best[y, u])
                elif mode == WHOLE:
                    whole = convert(cost, out)
                    if target[2] > 0 and (start > 0 or stop < n):
                        whole = inside(whole, min(start, n), max(stop, 0), volume.dtype.type(values[2]))
                    store(volume, (y * width + u) * target[0] + target[1], whole)
                elif mode == VOLUME:
                    scaled = convert(cost, real) * splat(values[0], real) + splat(values[1], real)
                    if target[2] > 0:
                        scaled = inside(scaled, min(start, n), max(stop, 0), values[2])
                    store(volume, (y * width + u) * target[0] + target[1], convert(scaled, out))
                else:
                    value, k = winner(cost, begin, end, best[y, u])
                    if k >= 0:
                        store(costs, 0, cost)
                        offset = 0.0
                        if start < k < stop - 1:
                            offset = fitted(fit, costs[k - 1], value, costs[k + 1])
                        best[y, u] = value
                        disparity[y, u] = first + k + offset

    return slide
