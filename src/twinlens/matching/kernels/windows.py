"""Sums over the square window around every pixel, and the scales that normalise a correlation."""

# numba types what it compiles by itself; its decorators and the functions given to it carry no annotations
# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-any-return, misc"

from typing import Any

import numpy as np

from twinlens.matching.kernels.compiling import jit

NO_SCALE, INVERSE_DEVIATION, INVERSE_NORM, TOTAL = 0, 1, 2, 3
FLAT = 1e-12  # a float window whose variance is below this part of its mean square has none: what is left is rounding


@jit
def scale_of(mode: int, area: Any, total: Any, squares: Any, flat: float) -> float:
    """1 / sqrt(n S2 - S^2), 1 / sqrt(S2), or S; 0 for a window without variance, or without light."""
    if mode == TOTAL:
        return np.float64(total)
    spread = squares if mode == INVERSE_NORM else area * squares - total * total
    if np.float64(spread) <= flat * np.float64(area) * np.float64(squares):
        return 0.0
    return 1.0 / np.sqrt(np.float64(spread))


@jit
def window_stats(image, radius, mode, flat, columns, offset, totals, scales):
    """Fill totals and scales, (H, offset + W or more), from column `offset` on.

    image (H + 2 r, W + 2 r) is padded; columns is a zeroed scratch (2, W + 2 r) in the dtype the sums are kept in.
    """
    side = 2 * radius + 1
    height, width = image.shape[0] - 2 * radius, image.shape[1] - 2 * radius
    area = columns.dtype.type(side * side)
    for y in range(1 - side, height):
        for x in range(width + 2 * radius):
            new = columns.dtype.type(image[y + side - 1, x])
            old = columns.dtype.type(image[y - 1, x]) if y > 0 else columns.dtype.type(0)
            columns[0, x] += new - old
            columns[1, x] += new * new - old * old
        if y < 0:
            continue
        total, squares = columns.dtype.type(0), columns.dtype.type(0)
        for x in range(2 * radius):
            total += columns[0, x]
            squares += columns[1, x]
        for x in range(width):
            total += columns[0, x + 2 * radius]
            squares += columns[1, x + 2 * radius]
            totals[y, offset + x] = total
            scales[y, offset + x] = scale_of(mode, area, total, squares, flat)
            total -= columns[0, x]
            squares -= columns[1, x]
