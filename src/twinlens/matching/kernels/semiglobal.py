"""Semi-global matching: scanline optimisation along several directions, LANES candidates at a time.

One sweep goes down the image with the paths from above and from the left; the other is the same sweep over the image
turned by 180 degrees. A path's costs at its last pixel are stored in a slot (one for each column, for the vertical
paths, and one for each diagonal), so a sweep needs memory for one row of paths.
The sweeps store not the paths' costs L but the detours L - C, at most P2 each, which fit 8 bits for short descriptors.
Source: Hirschmueller, "Stereo processing by semi-global matching and mutual information", PAMI 2008.
"""

import functools
from collections.abc import Callable

import numpy as np

from twinlens.matching.kernels import LANES
from twinlens.matching.kernels.compiling import inlined, jit
from twinlens.matching.kernels.lanes import convert, load, lowest, splat, store
from twinlens.matching.kernels.winners import winners_of_row

GUARD = 64  # numbers between two slots; those next to a slot are too large for a path to come from


@inlined
def step(slots, at, before, cost, penalty, least, jump):
    """Replace a path's costs L' in LANES slots by those of its next pixel, cost + detour.

    The detour, at most P2, is min(L', L'(d - 1) + P1, L'(d + 1) + P1, min L' + P2) - min L'. `before` holds L'(d - 1).
    Returns the detour, the lowest of the new costs, and `before` of the next LANES slots.
    """
    # Neighbouring disparities are neighbouring numbers of the slot, so L'(d + 1) is an unaligned load; L'(d - 1) was
    # loaded before the previous step overwrote it.
    near = min(load(slots, at + 1), before) + splat(penalty)
    detour = min(min(load(slots, at), near), splat(jump)) - splat(least)
    following = load(slots, at + LANES - 1)
    store(slots, at, cost + detour)
    return detour, lowest(cost + detour), following


def slot_count(height: int, width: int) -> int:
    """Number of slots of a sweep: one for the row, one per column, and one per diagonal of both directions."""
    return 1 + width + 2 * (width + height)


@functools.cache
def sweep_kernel(diagonals: bool) -> Callable[..., None]:
    """The kernel for some rows of a sweep, with or without the two diagonal paths.

    volumes: (costs, kept), rows of flat (H, W, depth) volumes, depth a multiple of LANES. paths: (slots, minima); slots
    are flat, 0 in the slots and between them numbers that no path's cost reaches; minima a 0 for each slot. penalties:
    (P1, P2). All have one unsigned dtype. span: (first, rows, H, W, depth); `first` counts the rows that the sweep has
    done before. turned: go up instead of down.

    finish False: kept receives the sum of the sweep's detours. finish True: kept holds those of the other sweep, and
    the sums of all paths' costs go to `winners_of_row`. search: (sums, low, count, fence); sums is scratch
    (W * depth,), candidate j is disparity low + j, fence (depth,) has the least value of each candidate's sum. result:
    (fit, limits, best, rivals, disparity) as in `winners_of_row`, with a row axis.
    """

    @jit
    def sweep(volumes, paths, span, penalties, turned, finish, search, result):
        costs, kept = volumes
        slots, minima = paths
        sums, low, count, fence = search
        fit, limits, best, rivals, disparity = result
        first, rows, height, width, depth = span
        small, large = penalties
        like = load(costs, 0)
        dtype = costs.dtype.type
        top = dtype(np.iinfo(costs.dtype).max)
        path_count = splat(np.uint16(8 if diagonals else 4))
        pitch = depth + GUARD
        for i in range(rows):
            # y: the row in the order of the sweep; r: its place in the arrays.
            y, r = first + i, rows - 1 - i if turned else i
            # The horizontal path starts anew in each row: without a previous pixel its cost is C alone.
            minima[0] = 0
            for j in range(GUARD, GUARD + depth):
                slots[j] = 0
            for x in range(width):
                u = width - 1 - x if turned else x
                at = (r * width + u) * depth
                # A diagonal has one slot for all its pixels: x - y is constant along one direction, x + y along the
                # other. Slots: 0 of the row, then of the columns, then of both kinds of diagonals.
                right, left = width + height + x - y, 1 + 2 * width + height + x + y
                row, column = GUARD, GUARD + (1 + x) * pitch
                falling, rising = GUARD + right * pitch, GUARD + left * pitch
                # min L' of the four paths, and min L' + P2, above which no path's cost can jump.
                m0, m1, m2, m3 = minima[0], minima[1 + x], minima[right], minima[left]
                j0, j1, j2, j3 = (
                    dtype(m0 + large),
                    dtype(m1 + large),
                    dtype(m2 + large),
                    dtype(m3 + large),
                )
                new0 = new1 = new2 = new3 = top
                # Before the first chunk, L'(d - 1) is a guard number, which is too large to come from.
                low0, low1 = load(slots, row - 1), load(slots, column - 1)
                low2 = low3 = like
                if diagonals:
                    low2, low3 = load(slots, falling - 1), load(slots, rising - 1)
                for chunk in range(0, depth, LANES):
                    cost = load(costs, at + chunk)
                    total, least, low0 = step(
                        slots, row + chunk, low0, cost, small, m0, j0
                    )
                    new0 = min(new0, least)
                    extra, least, low1 = step(
                        slots, column + chunk, low1, cost, small, m1, j1
                    )
                    new1, total = min(new1, least), total + extra
                    if diagonals:
                        extra, least, low2 = step(
                            slots, falling + chunk, low2, cost, small, m2, j2
                        )
                        new2, total = min(new2, least), total + extra
                        extra, least, low3 = step(
                            slots, rising + chunk, low3, cost, small, m3, j3
                        )
                        new3, total = min(new3, least), total + extra
                    if finish:
                        # L = C + detour on every path, so the sum is that of all detours, and C once for each path.
                        both = convert(total, sums) + convert(
                            load(kept, at + chunk), sums
                        )
                        both = both + convert(cost, sums) * path_count
                        store(sums, u * depth + chunk, max(both, load(fence, chunk)))
                    else:
                        store(kept, at + chunk, total)
                minima[0], minima[1 + x] = new0, new1
                if diagonals:
                    minima[right], minima[left] = new2, new3
            if finish:
                one = min(r, len(best) - 1)
                winners_of_row(
                    sums,
                    depth,
                    low,
                    count,
                    fit,
                    limits,
                    best[one],
                    rivals[one],
                    disparity[r],
                )

    return sweep
