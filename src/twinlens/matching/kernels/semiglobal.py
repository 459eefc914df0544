"""Semi-global matching: scanline optimisation along several directions, LANES candidates at a time.

A path r enters pixel p from its neighbour p - r. Its cost for disparity d is

    L(p, d) = C(p, d) + min(L'(d), L'(d - 1) + P1, L'(d + 1) + P1, min_i L'(i) + P2) - min_i L'(i),

with L' = L(p - r, .), the path's cost at the pixel before: equations (13) and (14) of the source. The last term keeps
the numbers small and does not move the minimum. What is added to C is here called the detour; it lies in [0, P2],
because the minimum contains min L' + P2 and nothing below min L'. The winner minimises the sum of L over all paths.

One sweep goes down the image with the paths from above and from the left; the other is the same sweep over the image
turned by 180 degrees. A path's costs at its last pixel are stored in a slot (one for each column, for the vertical
paths, and one for each diagonal), so a sweep needs memory for one row of paths.
The sweeps store not the paths' costs L but the detours L - C, at most P2 each, which fit 8 bits for short descriptors:
the sum over n paths is n C plus the sum of their detours.
Source: Hirschmueller, "Stereo processing by semi-global matching and mutual information", PAMI 2008.
"""

import functools
from collections.abc import Callable

import numpy as np

from twinlens.matching.kernels import LANES
from twinlens.matching.kernels.compiling import inlined, jit
from twinlens.matching.kernels.lanes import convert, load, lowest, splat, store
from twinlens.matching.kernels.winners import write_winners

GUARD = 64  # numbers between two slots; those next to a slot are too large for a path to come from
ROW = 0  # the slot of the horizontal path


@inlined
def step(slots, at, before, cost, penalty, least, jump, new):
    """Replace a path's costs L' in LANES slots by those of its next pixel, cost + detour.

    The detour, at most P2, is min(L', L'(d - 1) + P1, L'(d + 1) + P1, min L' + P2) - min L'. `before` holds L'(d - 1),
    `new` the minimum of L over the candidates before these. Returns the detour, and `before` and `new` of the next
    LANES slots.
    """
    # Neighbouring disparities are neighbouring numbers of the slot, so L'(d + 1) is an unaligned load; L'(d - 1) was
    # loaded before the previous step overwrote it.
    near = min(load(slots, at + 1), before) + splat(penalty)
    detour = min(min(load(slots, at), near), splat(jump)) - splat(least)
    following = load(slots, at + LANES - 1)
    store(slots, at, cost + detour)
    return detour, following, min(new, lowest(cost + detour))


def slot_count(height: int, width: int) -> int:
    """Number of slots of a sweep: one for the row, one per column, and one per diagonal of both directions."""
    return 1 + width + 2 * (width + height)


@inlined
def slots_of_pixel(x, y, height, width):
    """The slots of the vertical path and of both diagonal paths through pixel (x, y) of a sweep.

    All pixels of a path share a slot. x - y is constant along a diagonal that goes down and to the right, and lies
    between 1 - H and W - 1; x + y along one to the left, between 0 and W + H - 2. The offsets place these ranges behind
    each other: columns from 1 on, then W + H slots for each kind of diagonal.
    """
    return 1 + x, width + height + x - y, 1 + 2 * width + height + x + y


@inlined
def start_row(slots, minima, depth):
    """Start the horizontal path: without a pixel before, L' = 0 everywhere and its cost is C alone."""
    minima[ROW] = 0
    for j in range(GUARD, GUARD + depth):
        slots[j] = 0


@inlined
def sum_of_paths(detours, other_detours, cost, path_count, sums):
    """The sum of L over all paths, in the dtype of `sums`: the detours of both sweeps, and C once for each path."""
    both = convert(detours, sums) + convert(other_detours, sums)
    return both + convert(cost, sums) * path_count


@inlined
def sweep_pixel(
    volumes, paths, totals, depth, penalties, directions, at, u, slots_here
):
    """Carry all paths of a sweep through one pixel, whose costs begin at `at`; u is its column in the volumes.

    slots_here: as of `slots_of_pixel`. The paths advance together, one chunk of candidates at a time, so that each cost
    is loaded once.
    """
    costs, kept = volumes
    slots, minima = paths
    sums, fence, path_count = totals
    small, large = penalties
    _, finish, diagonals = directions
    column, right, left = slots_here
    dtype = costs.dtype.type
    pitch = depth + GUARD
    # Paths 0 to 3 are horizontal, vertical, and the diagonals to the right and to the left.
    # place: where the slot's costs begin in `slots`.
    place0, place1 = GUARD, GUARD + column * pitch
    place2, place3 = GUARD + right * pitch, GUARD + left * pitch
    # least: min L'. jump: min L' + P2, above which no path's cost can jump.
    least0, least1 = minima[ROW], minima[column]
    least2, least3 = minima[right], minima[left]
    jump0, jump1 = dtype(least0 + large), dtype(least1 + large)
    jump2, jump3 = dtype(least2 + large), dtype(least3 + large)
    # before: L'(d - 1). Before the first chunk it is a guard number, which is too large to come from.
    before0, before1 = load(slots, place0 - 1), load(slots, place1 - 1)
    before2 = before3 = before1
    if diagonals:
        before2, before3 = load(slots, place2 - 1), load(slots, place3 - 1)
    # new: the minimum of L over the chunks so far.
    new0 = new1 = new2 = new3 = dtype(np.iinfo(costs.dtype).max)
    for chunk in range(0, depth, LANES):
        cost = load(costs, at + chunk)
        detours, before0, new0 = step(
            slots, place0 + chunk, before0, cost, small, least0, jump0, new0
        )
        detour, before1, new1 = step(
            slots, place1 + chunk, before1, cost, small, least1, jump1, new1
        )
        detours = detours + detour
        if diagonals:
            detour, before2, new2 = step(
                slots, place2 + chunk, before2, cost, small, least2, jump2, new2
            )
            detours = detours + detour
            detour, before3, new3 = step(
                slots, place3 + chunk, before3, cost, small, least3, jump3, new3
            )
            detours = detours + detour
        if finish:
            of_other_sweep = load(kept, at + chunk)
            total = sum_of_paths(detours, of_other_sweep, cost, path_count, sums)
            store(sums, u * depth + chunk, max(total, load(fence, chunk)))
        else:
            store(kept, at + chunk, detours)
    minima[ROW], minima[column] = new0, new1
    if diagonals:
        minima[right], minima[left] = new2, new3


@inlined
def sweep_row(volumes, paths, totals, span, penalties, directions, y, r):
    """Carry all paths of a sweep through its row y, which is row r of the volumes.

    volumes, paths, penalties: see `sweep_kernel`. totals: (sums, fence, path_count). directions: (turned, finish,
    diagonals).
    """
    slots, minima = paths
    _, _, height, width, depth = span
    turned, _, _ = directions
    start_row(slots, minima, depth)
    for x in range(width):
        u = width - 1 - x if turned else x
        at = (r * width + u) * depth
        slots_here = slots_of_pixel(x, y, height, width)
        sweep_pixel(
            volumes, paths, totals, depth, penalties, directions, at, u, slots_here
        )


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
        sums, low, count, fence = search
        first, rows, _, _, depth = span
        totals = sums, fence, splat(np.uint16(8 if diagonals else 4))
        directions = turned, finish, diagonals
        for i in range(rows):
            # The row in the order of the sweep is first + i; r is its place in the arrays.
            r = rows - 1 - i if turned else i
            sweep_row(volumes, paths, totals, span, penalties, directions, first + i, r)
            if finish:
                write_winners(sums, depth, low, count, result, r)

    return sweep
