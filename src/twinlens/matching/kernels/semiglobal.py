"""Semi-global matching: scanline optimisation from several directions at once, all candidates in lanes.

One sweep goes down the image carrying the paths from above and from the left, the other is the same sweep over the
image turned by 180 degrees. A path's costs of its last pixel lie in a slot of their own (a column for the vertical
path, a diagonal's number for the diagonal ones), so a sweep needs memory for one row of paths, not for two.
Source: Hirschmueller, "Stereo processing by semi-global matching and mutual information", PAMI 2008.
"""
# numba types what it compiles by itself; its decorators and the functions given to it carry no annotations
# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-any-return, misc"

import functools
from collections.abc import Callable

import numpy as np

from twinlens.matching.kernels.compiling import inlined, jit
from twinlens.matching.kernels.lanes import first_equal, inside, load, lowest, smaller, splat, store
from twinlens.matching.kernels.slide import fitted

GUARD = 16  # numbers between two slots; the ones next to a slot are costs too high for a path to come from
TOO_HIGH = 1 << 14


@inlined
def step(cost, same, above, below, penalty, least, jump):
    """L = C + min(L', L'(d - 1) + P1, L'(d + 1) + P1, min L' + P2) - min L', in lanes."""
    near = smaller(above, below) + splat(penalty, cost)
    return cost + (smaller(smaller(same, near), splat(np.uint16(least + jump), cost)) - splat(least, cost))


def slot_count(height: int, width: int) -> int:
    """Slots that a sweep needs: one for the row, one a column, and one for each diagonal of both kinds."""
    return 1 + width + 2 * (width + height)


@functools.cache
def sweep_kernel(n: int, diagonals: bool, turned: bool) -> Callable[..., None]:
    """The sweep of n lanes: with the two diagonal paths or without, down the image or, turned, up.

    costs and total are flat (H, W, depth) uint16, depth a multiple of n; slots is flat, TOO_HIGH between its slots and
    0 in them; minima holds a 0 for each slot; penalties is (P1, P2) in uint16.
    """

    @jit
    def sweep(costs, total, slots, minima, height, width, depth, penalties):
        like = load(costs, 0, n)
        small, jump = penalties
        pitch = depth + GUARD
        for y in range(height):
            minima[0] = 0
            for j in range(GUARD, GUARD + depth):
                slots[j] = 0
            for x in range(width):
                at = (y * width + x) * depth
                if turned:
                    at = (height * width - 1) * depth - at
                right, left = width + height + x - y, 1 + 2 * width + height + x + y
                row, column = GUARD, GUARD + (1 + x) * pitch
                falling, rising = GUARD + right * pitch, GUARD + left * pitch
                m0, m1, m2, m3 = minima[0], minima[1 + x], minima[right], minima[left]
                new0 = new1 = new2 = new3 = np.uint16(65535)
                low0, low1 = load(slots, row - 1, n), load(slots, column - 1, n)
                low2 = low3 = like
                if diagonals:
                    low2, low3 = load(slots, falling - 1, n), load(slots, rising - 1, n)
                for chunk in range(0, depth, n):
                    cost = load(costs, at + chunk, n)
                    i = row + chunk
                    value = step(cost, load(slots, i, n), load(slots, i + 1, n), low0, small, m0, jump)
                    low0 = load(slots, i + n - 1, n)
                    store(slots, i, value)
                    new0, total_here = min(new0, lowest(value)), value
                    i = column + chunk
                    value = step(cost, load(slots, i, n), load(slots, i + 1, n), low1, small, m1, jump)
                    low1 = load(slots, i + n - 1, n)
                    store(slots, i, value)
                    new1, total_here = min(new1, lowest(value)), total_here + value
                    if diagonals:
                        i = falling + chunk
                        value = step(cost, load(slots, i, n), load(slots, i + 1, n), low2, small, m2, jump)
                        low2 = load(slots, i + n - 1, n)
                        store(slots, i, value)
                        new2, total_here = min(new2, lowest(value)), total_here + value
                        i = rising + chunk
                        value = step(cost, load(slots, i, n), load(slots, i + 1, n), low3, small, m3, jump)
                        low3 = load(slots, i + n - 1, n)
                        store(slots, i, value)
                        new3, total_here = min(new3, lowest(value)), total_here + value
                    store(total, at + chunk, total_here)
                minima[0], minima[1 + x] = new0, new1
                if diagonals:
                    minima[right], minima[left] = new2, new3

    return sweep


@functools.cache
def settle_kernel(n: int) -> Callable[..., None]:
    """Winner-take-all over the sum of two volumes, flat (H, W, depth) uint16, in n lanes.

    As `choose`: of `count` candidates from disparity `low` on, those with a partner in the image. `sums` (depth,) is a
    scratch. rivals is (H, W), or (1, 1) where no one asks for them.
    """

    @jit
    def settle(one, other, depth, low, count, fit, sums, best, rivals, disparity):
        height, width = best.shape
        for y in range(height):
            for x in range(width):
                start, stop = max(0, x - low - width + 1), min(count, x - low + 1)
                if start >= stop:
                    continue
                at = (y * width + x) * depth
                least = np.uint16(65535)
                for chunk in range(0, depth, n):
                    value = load(one, at + chunk, n) + load(other, at + chunk, n)
                    if start > chunk or stop < chunk + n:
                        first, last = min(max(start - chunk, 0), n), min(max(stop - chunk, 0), n)
                        value = inside(value, first, last, np.uint16(65535))
                    store(sums, chunk, value)
                    least = min(least, lowest(value))
                k = start
                for chunk in range(0, depth, n):
                    value = load(sums, chunk, n)
                    if lowest(value) == least:
                        k = chunk + first_equal(value, least)
                        break
                offset = 0.0
                if start < k < stop - 1:
                    offset = fitted(fit, sums[k - 1], least, sums[k + 1])
                best[y, x] = least
                disparity[y, x] = low + k + offset
                if rivals.shape == best.shape:
                    second = np.float64(np.inf)
                    for j in range(start, stop):
                        if abs(j - k) > 1:
                            second = min(second, np.float64(sums[j]))
                    rivals[y, x] = second

    return settle
