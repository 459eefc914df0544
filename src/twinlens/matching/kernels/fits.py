"""Between whole disparities: where the cost's minimum lies, from the winner's cost and its two neighbours'."""

# numba types what it compiles by itself; its decorators and the functions given to it carry no annotations
# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-any-return, misc"

from typing import Any

import numpy as np

from twinlens.matching.kernels.compiling import inlined, jit

NO_FIT, V_FIT, PARABOLA_FIT = 0, 1, 2


@inlined
def fitted(fit: int, before: Any, here: Any, after: Any) -> float:
    """Offset of the minimum, in [-0.5, 0.5] pixels, from the costs at d - 1, d and d + 1.

    V: two lines of equal and opposite slope, (before - after) / (2 (max(before, after) - here)); its truth is an
    absolute difference. Parabola: (before - after) / (2 (before - 2 here + after)); its truth is a square.
    Shimizu and Okutomi, "Sub-pixel estimation error cancellation on area-based matching", IJCV 2005.
    """
    a, c, b = np.float64(before), np.float64(here), np.float64(after)
    bend = 2.0 * (max(a, b) - c) if fit == V_FIT else 2.0 * (a - 2.0 * c + b)
    bends = fit != NO_FIT and bend > 0.0
    ratio = (a - b) / (bend if bends else 1.0)
    return ratio if bends else 0.0


@jit
def offsets(fit, before, here, after, offset):
    """offset = `fitted`, for a row of pixels at once."""
    for x in range(len(offset)):
        offset[x] = fitted(fit, before[x], here[x], after[x])


@jit
def settle_row(first, low, high, lane, value, offset, best, disparity, index):
    """Take over what a pass found along a row, where it costs less than `best`; index is (1,) where no one asks for it.

    Lane 0 is the disparity `first`, lanes low..high are candidates. A winner at an end of its pixel's range is whole.
    """
    width = len(best)
    for x in range(width):
        k = np.int64(lane[x])
        start, stop = max(low, x - first - width + 1, 0), min(high, x - first + 1)
        between = (k > start) & (k < stop - 1)
        found = np.float32((first + k) + (offset[x] if between else 0.0))
        lower = value[x] < best[x]
        best[x] = value[x] if lower else best[x]
        disparity[x] = found if lower else disparity[x]
        if len(index) == width:
            index[x] = first + k if lower else index[x]
