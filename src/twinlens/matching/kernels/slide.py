"""Costs over a square window for every measure that is a box sum of a pixel term, in O(W D) memory.

For each image row, the kernel keeps the sum of a term over each column of the window, for every candidate. One row
further down, it adds the term of the row below and subtracts that of the row above. Along the row, the window's sum
gains the column that enters and loses the one that leaves. The right image is reversed in memory, so that a growing
disparity reads forward.

`left` is padded by the radius on each side. `right` is padded and reversed such that candidate j of the padded column x
is right[row, start - x + j]. Both are flat; their row strides and `start` are the `layout`.
"""

import functools
from collections.abc import Callable

import numpy as np

from twinlens.matching.kernels import LANES
from twinlens.matching.kernels.compiling import inlined, jit
from twinlens.matching.kernels.lanes import (
    convert,
    count_ones,
    load,
    read,
    splat,
    store,
)
from twinlens.matching.kernels.winners import write_winners


@inlined
def pixel_term(term, left, here, right, there, sums):
    """What a pixel adds to its window's sum, in the dtype of `sums`, for the pixels at the places here and there."""
    a, b = splat(read(left, here)), load(right, there)
    if term == "absolute":
        value = convert(max(a, b) - min(a, b), sums)
    elif term == "square":
        difference = convert(max(a, b) - min(a, b), sums)
        value = difference * difference
    elif term == "product":
        value = convert(a, sums) * convert(b, sums)
    elif term == "hamming":
        value = convert(count_ones(a ^ b), sums)
    else:  # interpolated: the image is followed by its minima and by its maxima within half a pixel
        rest, others = len(left) // 3, len(right) // 3
        ours = max(a - load(right, there + 2 * others), load(right, there + others) - a)
        theirs = max(
            b - splat(read(left, here + 2 * rest)), splat(read(left, here + rest)) - b
        )
        value = max(min(ours, theirs), convert(splat(0), sums))
    return value


@inlined
def store_scaled(volume, at, cost, scale):
    """volume[at:] = cost * scale[0] + scale[1], computed in the dtype of `scale`."""
    gain, offset = splat(read(scale, 0)), splat(read(scale, 1))
    store(volume, at, convert(convert(cost, scale) * gain + offset, volume))


@inlined
def score(scoring, total, costs, statistics, area, here, there):
    """The cost, in the dtype of `costs`, of a window's sum. here and there: places of the windows' statistics.

    With n pixels a, b of both windows, S_L = sum a, S_R = sum b and S_LR = sum a b, the means need no second pass:
    sum a' b' = S_LR - S_L S_R / n, of windows minus their means. Multiplied by n this stays a whole number, and the
    factors of numerator and denominator cancel:
    ZNCC = (n S_LR - S_L S_R) / sqrt((n S_LL - S_L^2) (n S_RR - S_R^2)), of which the roots are the `scales`;
    n ZSSD = n sum (a - b)^2 - (S_L - S_R)^2. Similarities are negated; 1 - similarity is completed outside.
    Source: Lewis, "Fast normalized cross-correlation", Vision Interface 1995.
    """
    left_totals, left_scales, right_totals, right_scales = statistics
    if scoring == "sum":
        value = total
    elif scoring == "zncc":
        product = splat(read(left_totals, here)) * load(right_totals, there)
        # Minus n times the sum of a' b': exact in whole numbers, before it is rounded to the dtype of the costs.
        covariance = convert(product - area * convert(total, left_totals), costs)
        value = covariance * load(right_scales, there) * splat(read(left_scales, here))
    elif scoring == "ncc":
        value = (
            convert(total, costs)
            * load(right_scales, there)
            * splat(-read(left_scales, here))
        )
    elif scoring == "zssd":
        offset = splat(read(left_totals, here)) - load(right_totals, there)
        value = convert(area * convert(total, left_totals) - offset * offset, costs)
    else:  # Jaccard: 1 - (S - SAD) / (S + SAD), with S the sum of both windows' totals
        sad = convert(total, costs)
        union = splat(read(left_scales, here)) + load(right_scales, there) + sad
        value = (sad + sad) / max(union, convert(splat(np.float64(1e-30)), costs))
    return value


@functools.cache
def slide_kernel(term: str, scoring: str, volumes: bool) -> Callable[..., None]:
    """The kernel for one pixel term and one scoring of `costs.Cost`.

    images: (left, right, layout). window: (side, first row of the result in the images, rows). search: (low, count,
    depth); candidate j is disparity low + j. columns: flat zeros (padded width + side, depth) for the sums of columns;
    size 0 where side is 1. costs: flat scratch (W, depth); size 0 with `volumes`. fence (depth,): the least cost of
    each candidate. statistics: (left totals, left scales, right totals, right scales) as of
    `windows.window_statistics`, flat with the rows of the result; size 1 where the scoring takes none.

    Without `volumes`, result is (fit, limits, best, rivals, disparity) as in `winners_of_row`, with a row axis. With
    it, result is (volume, scale), and the flat volume (rows, W, depth) receives cost * scale[0] + scale[1], computed in
    the dtype of `scale`. Candidates without a partner in the image have the cost of edge-continued images.
    """

    @jit
    def slide(images, window, search, columns, costs, fence, statistics, result):
        left, right, layout = images
        left_stride, right_stride, right_start = layout
        side, top, rows = window
        low, count, depth = search
        padded = left_stride
        width = padded - side + 1
        statistics_stride = right_stride - side + 1
        zero = convert(splat(0), columns)
        area = convert(splat(side * side), statistics[0])
        # One loop nest without inlined parts of its own: with the column's sum in a function, LLVM keeps the total in
        # memory and the kernel takes twice the time.
        # The first side - 1 rows only fill the sums of columns: the first window is complete at y = 0.
        for y in range(1 - side, rows):
            new, old = top + y + side - 1, top + max(y - 1, 0)
            new_left, old_left = new * left_stride, old * left_stride
            new_right = new * right_stride + right_start
            old_right = old * right_stride + right_start
            # Candidates outside, pixels inside: the window's sum of LANES candidates stays in registers along the row.
            for chunk in range(0, depth, LANES):
                base, total = chunk * (padded + side), zero
                for x in range(padded):
                    # Candidate j of the padded column x is `x` places before that of column 0 in the reversed image.
                    here, there = new_left + x, new_right + chunk - x
                    gained = pixel_term(term, left, here, right, there, columns)
                    if side == 1:
                        total = gained
                    else:
                        # The sum of the column gains the row below, and loses the row above from the second on.
                        enters, leaves = base + (x + side) * LANES, base + x * LANES
                        column = load(columns, enters) + gained
                        if y > 0:
                            here, there = old_left + x, old_right + chunk - x
                            lost = pixel_term(term, left, here, right, there, columns)
                            column = column - lost
                        store(columns, enters, column)
                        # The columns before the first are zeros, so that the first windows need no case of their own.
                        total = total + (column - load(columns, leaves))
                    u = x - side + 1
                    if y < 0 or u < 0:
                        continue
                    ours = y * width + u
                    theirs = y * statistics_stride + right_start - x + chunk
                    cost = score(scoring, total, costs, statistics, area, ours, theirs)
                    if volumes:
                        volume, scale = result
                        store_scaled(volume, ours * depth + chunk, cost, scale)
                    else:
                        store(costs, u * depth + chunk, max(cost, load(fence, chunk)))
            if not volumes and y >= 0:
                write_winners(costs, depth, low, count, result, y)

    return slide
