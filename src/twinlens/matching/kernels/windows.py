"""Sums over the square window around every pixel, and the scales that normalise a correlation."""

# numba types what it compiles by itself; its decorators and the functions given to it carry no annotations
# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-any-return, misc"

import numpy as np

from twinlens.matching.kernels.compiling import jit

NO_SCALE, INVERSE_DEVIATION, INVERSE_NORM, TOTAL = 0, 1, 2, 3
FLAT = 1e-12  # a float window whose variance is below this part of its mean square has none: what is left is rounding


@jit
def scale(mode, flat, area, totals, squares, scales):
    """scales = 1 / sqrt(n S2 - S^2), or 1 / sqrt(S2); 0 for a window without variance, or without light.

    The type of `area` is what this is computed in: integers where float64 would round.
    """
    for x in range(len(totals)):
        total, square = area * 0 + totals[x], area * 0 + squares[x]
        spread = square if mode == INVERSE_NORM else area * square - total * total
        there = spread > flat * area * square
        root = np.sqrt(np.float64(spread if there else area))
        scales[x] = 1.0 / root if there else 0.0


@jit
def window_stats(image, radius, mode, flat, area, columns, offset, totals, scales):
    """Fill totals and scales, (H, offset + W or more), from column `offset` on; without a mode, totals alone.

    image (H + 2 r, W + 2 r) is padded; area is (2 r + 1)^2 in the type that scales are computed in; columns is a
    zeroed scratch (3, W + 2 r) in the dtype the sums are kept in.
    """
    side = 2 * radius + 1
    height, width = image.shape[0] - 2 * radius, image.shape[1] - 2 * radius
    squared = mode != TOTAL and mode != NO_SCALE
    sums, squares, spare = columns[0], columns[1], columns[2]
    for y in range(1 - side, height):
        new = image[y + side - 1]
        for x in range(width + 2 * radius):
            sums[x] += columns.dtype.type(new[x])
        if squared:
            for x in range(width + 2 * radius):
                value = columns.dtype.type(new[x])
                squares[x] += value * value
        if y > 0:
            old = image[y - 1]
            for x in range(width + 2 * radius):
                sums[x] -= columns.dtype.type(old[x])
            if squared:
                for x in range(width + 2 * radius):
                    value = columns.dtype.type(old[x])
                    squares[x] -= value * value
        if y < 0:
            continue
        # Added up anew at every pixel, not slid: that has no chain, and goes through many pixels at once.
        total, square = totals[y, offset : offset + width], spare[:width]
        total[:] = 0
        for k in range(side):
            for x in range(width):
                total[x] += totals.dtype.type(sums[x + k])
        if mode == TOTAL:
            for x in range(width):
                scales[y, offset + x] = total[x]
        if squared:
            square[:] = 0
            for k in range(side):
                for x in range(width):
                    square[x] += squares[x + k]
            scale(mode, flat, area, total, square, scales[y, offset : offset + width])
