"""Winner-take-all with one square window: every measure that is a box sum of a pixel term, in O(W D) memory.

For each image row, the sum of a term over a column of the window is kept for every x and candidate; stepping a row
down adds the term below and takes the term above away. Sliding right along the row, the window's sum gains the column
that enters and loses the one that leaves. Both steps act on all candidates at once (`lanes`); the right image lies
reversed in memory so that growing disparity reads forward. The winner is found in registers; its lane and its
neighbours' costs are put down in rows, and what becomes of them is computed for a whole row at once.

The layout that the caller prepares (`matching.box`): `left` is padded by the radius on each side; `right` is padded
and reversed such that lane j of the padded column x is right[row, start - x + j]. Both flat, with their row strides.
"""

# numba types what it compiles by itself; its decorators and the functions given to it carry no annotations
# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-any-return, misc"

import functools
from collections.abc import Callable

import numpy as np

from twinlens.matching.kernels.compiling import inlined, jit
from twinlens.matching.kernels.fences import fenced
from twinlens.matching.kernels.fits import NO_FIT, offsets, settle_row
from twinlens.matching.kernels.lanes import convert, inside, load, read, splat, store, write
from twinlens.matching.kernels.pairs import PAIRED, slide_products, weave_left, weave_right, with_both_terms
from twinlens.matching.kernels.pick import first_at_most, lowest
from twinlens.matching.kernels.terms import score, term
from twinlens.matching.kernels.windows import NOTHING, advance, window_row

WINNERS, RIVALS, VOLUME, WHOLE = 0, 1, 2, 3
SLOTS = 4  # pixels whose costs are kept: a row of them would not stay near the processor
GUARD = 64  # numbers before a pixel's costs, so that a winner in lane 0 has a neighbour to read


@inlined
def rival(cost, begin, end, k, bar):
    """The lowest cost, or `bar` if that is lower, among lanes begin..end that are not the winner k or next to it."""
    below = inside(cost, begin, min(max(k - 1, 0), end), bar)
    above = inside(cost, max(min(k + 2, end), begin), end, bar)
    return min(lowest(below), lowest(above))


@inlined
def winner(cost, slack):
    """The lowest cost, and the first lane that is not dearer by more than `slack`."""
    least = lowest(cost)
    return least, first_at_most(cost, least + slack)


@functools.cache
def slide_kernel(kind: str, scoring: str, n: int, mode: int) -> Callable[..., None]:
    """The kernel for one pixel term, one scoring and n lanes.

    WINNERS lowers `best` (H, W) to the lowest cost, fills disparity with where it lies, and index, unless it is (1, 1),
    with the whole disparity of it. RIVALS is given the winners in `index` and lowers `best` to the cost of the best
    candidate at least two away. VOLUME writes every candidate's cost * gain + offset to the flat `volume`,
    (H, W, depth), at the candidates from `place` on; candidates that do not exist get `blank` where `masked` is set,
    otherwise what the edge-continued images give. WHOLE is VOLUME for whole numbers that the volume holds as they are.
    `spans` is (radius, area, disparity of lane 0, low, high, begin, end): lanes low..high lie in the requested range,
    lanes begin..end may win in this pass. `modes` says which statistics of the left and the right windows the scoring
    takes (`windows`), `area` is the window's in the type they are computed in, left_state, right_state and the two
    `equal`s are their columns' sums. Costs above the least by no more than
    `slack` count as equal to it. `target` is (depth, place, masked), `values` is (gain, offset, blank).
    """
    paired, signed, twice = kind in PAIRED, kind == "product8", 2 * n

    @jit
    def slide(
        left, right, layout, spans, modes, area, left_state, right_state, equals, fit, slack,
        columns, costs, fence, best, disparity, index, volume, target, values,
    ):  # fmt: skip
        height, width = best.shape
        left_stride, right_stride, right_start = layout
        radius, window_area, first, low, high, own_begin, own_end = spans
        side = 2 * radius + 1
        zero, like = load(columns, 0, n), load(costs, GUARD, n)
        real, out = splat(values[0], zero), splat(volume[0], zero)
        pairs = np.zeros(2 * right_stride if paired else 1, np.uint8)
        both = np.zeros(left_stride if paired else 1, np.int32)
        totals, scales = np.zeros(width, columns.dtype), np.zeros(width, costs.dtype)
        there_totals = np.zeros(right_stride if modes[1] != NOTHING else 1, columns.dtype)
        there_scales = np.zeros(right_stride if modes[1] != NOTHING else 1, costs.dtype)
        lanes, found = np.zeros(width + 2, np.int32), np.zeros((3, width + 2), costs.dtype)
        before, value, after = found[0], found[1], found[2]
        # Found a pixel later, and written where that pixel is; the neighbours' costs two later.
        row_lanes, row_value = lanes[1 : width + 1], value[1 : width + 1]
        row_before, row_after = before[2:], after[2:]
        waiting, last = like, 0
        offset = np.zeros(width, np.float64)
        spare_left, spare_right = np.empty_like(left_state), np.empty_like(right_state)
        whole = own_begin == 0 and own_end == n and low <= 0 and high >= n
        full_from, full_to = (first + n - 1, first + width) if whole else (0, 0)
        for y in range(1 - side, height):
            window = zero
            row, gone, leaves = y + side - 1, max(y - 1, 0), y > 0
            new_left = left[row * left_stride : (row + 1) * left_stride]
            old_left = left[gone * left_stride : (gone + 1) * left_stride]
            new_right = right[row * right_stride : (row + 1) * right_stride]
            old_right = right[gone * right_stride : (gone + 1) * right_stride]
            if paired:
                weave_left(new_left, old_left, leaves, signed, both)
                weave_right(new_right, old_right, leaves, pairs)
            if modes[0] != NOTHING:
                advance(modes[0], new_left, old_left, leaves, left_state, equals[0])
                if y >= 0:
                    window_row(modes[0], side, area, new_left, left_state, equals[0], spare_left, totals, scales)
            if modes[1] != NOTHING:
                advance(modes[1], new_right, old_right, leaves, right_state, equals[1])
                if y >= 0:
                    count = right_stride - 2 * radius
                    parts = there_totals[:count], there_scales[:count]
                    window_row(modes[1], side, area, new_right, right_state, equals[1], spare_right, *parts)
            for x in range(width + 2 * radius):
                at = right_start - x
                if kind == "product8":
                    window = slide_products(window, columns, (x + side) * n, x * n, pairs, at, read(both, x))
                else:
                    column = load(columns, (x + side) * n, n)
                    if paired:
                        column = with_both_terms(kind, column, load(pairs, 2 * at, twice), read(both, x))
                    else:
                        column = column + term(kind, splat(read(new_left, x), zero), load(new_right, at, n), zero)
                        if leaves:
                            column = column - term(kind, splat(read(old_left, x), zero), load(old_right, at, n), zero)
                    store(columns, (x + side) * n, column)
                    window = window + (column - load(columns, x * n, n))
                u = x - 2 * radius
                if y < 0 or u < 0:
                    continue
                if mode == WINNERS:
                    # The winner of the pixel before, and the neighbours of the one before that: their instructions
                    # wait for each other, and the processor fills the time with this pixel's.
                    least, k = winner(waiting, slack[0])
                    write(value, u, least)
                    write(lanes, u, np.int32(k))
                    place = GUARD + (u - 2) % SLOTS * n + last
                    write(before, u, read(costs, place - 1))
                    write(after, u, read(costs, place + 1))
                    last = k
                total, scale = read(totals, u), read(scales, u)
                cost = score(scoring, window, window_area, total, scale, there_totals, there_scales, at, like)
                start, stop = max(low, u - first - width + 1, 0), min(high, u - first + 1, n)
                if mode == WINNERS:
                    store(costs, GUARD + u % SLOTS * n, cost)
                    waiting = cost
                    if u < full_from or u >= full_to:
                        waiting = fenced(cost, fence, n, max(start, own_begin), min(stop, own_end))
                elif mode == RIVALS:
                    begin, end = max(start, own_begin), min(stop, own_end)
                    if begin < end:
                        best[y, u] = rival(cost, begin, end, index[y, u] - first, best[y, u])
                elif mode == WHOLE:
                    written = convert(cost, out)
                    if target[2] > 0 and (start > 0 or stop < n):
                        written = inside(written, min(start, n), max(stop, 0), volume.dtype.type(values[2]))
                    store(volume, (y * width + u) * target[0] + target[1], written)
                else:
                    scaled = convert(cost, real) * splat(values[0], real) + splat(values[1], real)
                    if target[2] > 0:
                        scaled = inside(scaled, min(start, n), max(stop, 0), values[2])
                    store(volume, (y * width + u) * target[0] + target[1], convert(scaled, out))
            if mode == WINNERS and y >= 0:
                # What the last two pixels still lack.
                least, k = winner(waiting, slack[0])
                write(value, width, least)
                write(lanes, width, np.int32(k))
                for u in range(width, width + 2):
                    place = GUARD + (u - 2) % SLOTS * n + last
                    write(before, u, read(costs, place - 1))
                    write(after, u, read(costs, place + 1))
                    last = k
                if fit != NO_FIT:
                    offsets(fit, row_before, row_value, row_after, offset)
                kept = index[min(y, len(index) - 1)]
                settle_row(first, low, high, row_lanes, row_value, offset, best[y], disparity[y], kept)

    return slide
