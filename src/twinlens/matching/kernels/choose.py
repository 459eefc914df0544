"""Winner-take-all on a cost volume that is already there."""
# numba types what it compiles by itself; its decorators and the functions given to it carry no annotations
# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-any-return, misc"

import numpy as np

from twinlens.matching.kernels.compiling import jit
from twinlens.matching.kernels.fits import fitted


@jit
def choose(volume, low, count, fit, best, rivals, disparity):
    """The lowest candidate of each pixel, its cost, and the lowest cost at least two candidates away.

    volume (rows, W, depth): candidate j is disparity low + j, of which the first `count` are searched, and of these
    the ones whose partner lies inside the image. Without candidates a pixel stays as it is.
    """
    rows, width, _ = volume.shape
    for y in range(rows):
        for x in range(width):
            start, stop = max(0, x - low - width + 1), min(count, x - low + 1)
            if start >= stop:
                continue
            costs = volume[y, x]
            least = costs[start]
            for j in range(start + 1, stop):
                least = min(least, costs[j])
            k = start
            while costs[k] > least:
                k += 1
            rival = np.inf
            for j in range(start, k - 1):
                rival = min(rival, np.float64(costs[j]))
            for j in range(k + 2, stop):
                rival = min(rival, np.float64(costs[j]))
            best[y, x], rivals[y, x] = least, rival
            offset = fitted(fit, costs[k - 1], least, costs[k + 1]) if start < k < stop - 1 else 0.0
            disparity[y, x] = low + k + offset
