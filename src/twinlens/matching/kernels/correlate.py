"""Winner-take-all by ZNCC of bytes, where no one asks for the costs: the kernel of `slide`, made for this one measure.

A window's sum changes, from one row of the image to the next, by what its new row adds less what its old row takes
away. That change is kept in registers for all candidates at once and slides right along the row (`quads`); the sums
themselves lie in memory, one for each x and candidate. What they are sums of is n (L - c) R, with a constant c that
brings the left image's bytes to both sides of zero: the n-fold covariance n sum(L R) - sum(L) sum(R) is the same for
L - c, and all of it is exact in 32 bits. The scale of the left window is left out: it is the same for all candidates.
"""

# numba types what it compiles by itself; its decorators and the functions given to it carry no annotations
# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-any-return, misc"

import functools
from collections.abc import Callable

import numpy as np

from twinlens.matching.kernels.compiling import inlined, jit
from twinlens.matching.kernels.fences import barred
from twinlens.matching.kernels.fits import NO_FIT, offsets, settle_row
from twinlens.matching.kernels.lanes import as_floats, convert, inside, lane, load, read, splat, write
from twinlens.matching.kernels.pick import first_at_most, first_equal, highest, lowest
from twinlens.matching.kernels.quads import (
    gather_sums,
    similarities,
    slide_quads,
    weave_factors,
    weave_quads,
    weave_rests,
)
from twinlens.matching.kernels.windows import DEVIATIONS, TOTALS, advance, window_row

GUARD = 16  # numbers before the first and after the last: neighbours are read there
MORE = 2  # pixels past the end of a row, so that all of its own are done with


def room(width: int, n: int) -> int:
    """How many sums the kernel for n lanes keeps for an image of this width."""
    return (width + 2 * MORE) * n + 2 * GUARD


@inlined
def best_unlike(bits, begin, end):
    """(similarity, lane) of the most similar of the lanes begin..end, the first of equal ones, where none is above 0.

    -inf, and any lane, where begin..end is empty.
    """
    zero = splat(np.float32(0), as_floats(bits))
    cost = inside(zero - as_floats(bits), begin, end, np.float32(np.inf))
    least = lowest(cost)
    return -least, first_at_most(cost, least)


@inlined
def costs_around(sums, place, totals, scales, at, minus, four):
    """Minus the similarities of four lanes, from sums[place] and totals[at] and scales[at] on."""
    window = load(sums, place, 4) + splat(minus, four) * convert(load(totals, at, 4), four)
    scale = load(scales, at, 4)
    return convert(four - window, scale) * scale


@functools.cache
def correlation_kernel(n: int) -> Callable[..., None]:
    """The kernel for n lanes.

    It lowers `best` (H, W) float32 to the least of minus the windows' correlation times a factor of the left window's,
    and fills disparity with where it lies. left, right, layout, spans and fit are `slide`'s. centre is 127 or 128,
    and `rare` says whether `weave_rests` finds anything. area (1,) int32 is the window's; sums are `room` int32 zeros;
    fence is `barred`'s.
    """

    @jit
    def correlate(left, right, layout, spans, centre, rare, area, fit, sums, fence, best, disparity):
        height, width = best.shape
        left_stride, right_stride, right_start = layout
        radius, window_area, first, low, high, own_begin, own_end = spans
        side, across, weight, lead = 2 * radius + 1, 2 * radius, np.int32(window_area), GUARD + MORE * n
        zero, four = load(sums, 0, n), load(sums, 0, 4)
        quads, equal = np.zeros(MORE + right_stride, np.uint32), np.zeros(1, np.int64)
        factors, rests = np.zeros(left_stride + MORE, np.int32), np.zeros(left_stride + MORE, np.int32)
        left_state, right_state = np.zeros((3, left_stride), np.int32), np.zeros((3, right_stride), np.int32)
        spare_left, spare_right = np.empty_like(left_state), np.empty_like(right_state)
        totals, nothing = np.zeros(width, np.int32), np.zeros(1, np.float32)
        count = right_stride - across
        there_totals, there_scales = np.zeros(count + 2 * GUARD, np.uint16), np.zeros(count + 2 * GUARD, np.float32)
        inner_totals, inner_scales = there_totals[GUARD : GUARD + count], there_scales[GUARD : GUARD + count]
        # Minus the left windows' totals, of `MORE` pixels before the row and of the row.
        minus = np.zeros(width + 2 * MORE, np.int32)
        lanes, likeness = np.zeros(width + MORE, np.int32), np.zeros(width + MORE, np.float32)
        before, after = np.zeros(width + MORE, np.float32), np.zeros(width + MORE, np.float32)
        offset = np.zeros(width, np.float64)
        value, index = np.zeros(width, np.float32), np.zeros(1, np.int32)
        # The right windows centred inside the image; the others are given no likeness.
        seen = max(right_start - across - width + 1 - first, 0), max(right_start - across + 1 - first, 0)
        whole = own_begin == 0 and own_end == n and low <= 0 and high >= n
        for y in range(1 - side, height):
            row, gone, leaves = y + side - 1, max(y - 1, 0), y > 0
            new_left = left[row * left_stride : (row + 1) * left_stride]
            old_left = left[gone * left_stride : (gone + 1) * left_stride]
            new_right = right[row * right_stride : (row + 1) * right_stride]
            old_right = right[gone * right_stride : (gone + 1) * right_stride]
            weave_quads(new_right, old_right, side, quads[MORE:])
            weave_factors(new_left, old_left, leaves, side, centre, factors)
            if rare:
                weave_rests(new_left, old_left, leaves, side, centre, rests)
            advance(TOTALS, new_left, old_left, leaves, left_state, equal)
            advance(DEVIATIONS, new_right, old_right, leaves, right_state, equal)
            if y >= 0:
                window_row(TOTALS, side, area, new_left, left_state, equal, spare_left, totals, nothing)
                parts = inner_totals, inner_scales
                window_row(DEVIATIONS, side, area, new_right, right_state, equal, spare_right, *parts)
                inner_scales[: seen[0]] = 0
                inner_scales[seen[1] :] = 0
                for u in range(width):
                    minus[u + MORE] = weight * centre - totals[u]
            change, waiting, last = zero, zero, 0
            for x in range(across):
                change = slide_quads(change, quads, MORE + right_start - x, read(factors, x), read(rests, x))
            for u in range(width + MORE):
                x = u + across
                at = right_start - x
                change = slide_quads(change, quads, MORE + at, read(factors, x), read(rests, x))
                window = gather_sums(change, sums, lead + u * n, weight)
                if y < 0:
                    continue
                # The winner of the pixel before, and the neighbours of the one before that: their instructions wait for
                # each other, and the processor fills the time with this pixel's.
                most = highest(waiting)
                k = first_equal(waiting, most)
                write(likeness, u, as_floats(most))
                if most <= 0:
                    start, stop = max(low, u - first - width, 0), min(high, u - first, n)
                    similarity, k = best_unlike(waiting, max(start, own_begin), min(stop, own_end))
                    write(likeness, u, similarity)
                write(lanes, u, np.int32(k))
                place, beside = lead + (u - 2) * n + last - 1, GUARD + at + 1 + last
                near = costs_around(sums, place, there_totals, there_scales, beside, read(minus, u), four)
                write(before, u, lane(near, 0))
                write(after, u, lane(near, 2))
                last = k
                waiting = similarities(window, read(minus, u + MORE), there_totals, there_scales, GUARD + at)
                if not whole:
                    start, stop = max(low, u - first - width + 1, 0), min(high, u - first + 1, n)
                    waiting = barred(waiting, fence, n, max(start, own_begin), min(stop, own_end))
            if y >= 0:
                for u in range(width):
                    value[u] = -likeness[u + 1]
                if fit != NO_FIT:
                    offsets(fit, before[MORE:], value, after[MORE:], offset)
                settle_row(first, low, high, lanes[1:], value, offset, best[y], disparity[y], index)

    return correlate
