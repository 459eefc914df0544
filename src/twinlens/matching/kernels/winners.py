"""Winner-take-all over the costs of a row of pixels, with a sub-pixel fit, and the counts of near candidates."""

import numpy as np

from twinlens.matching.kernels import LANES
from twinlens.matching.kernels.compiling import inlined, jit
from twinlens.matching.kernels.lanes import (
    first_at_most,
    load,
    lowest,
    mask_outside,
    store,
)

NO_FIT, V_FIT, PARABOLA_FIT = 0, 1, 2


@inlined
def fitted(fit, before, here, after):
    """Offset of the minimum, in [-0.5, 0.5] pixels, from the costs a, c, b at d - 1, d and d + 1.

    Parabola, for squares: through the points (-1, a), (0, c), (1, b) it is c + (b - a) t / 2 + (a - 2 c + b) t^2 / 2,
    with its vertex at t = (a - b) / (2 (a - 2 c + b)).
    V, for absolute differences: two lines of opposite slope. The steeper side has the slope s = max(a, b) - c, and the
    lines meet at t = (a - b) / (2 s): a pair of lines through (-1, a) and (1, b) with the slopes -s and s.
    Source: Shimizu and Okutomi, "Sub-pixel estimation error cancellation on area-based matching", IJCV 2005.
    """
    a, c, b = np.float64(before), np.float64(here), np.float64(after)
    bend = 2.0 * (max(a, b) - c) if fit == V_FIT else 2.0 * (a - 2.0 * c + b)
    # Of three equal costs there is no minimum between the candidates. Both selects are branch-free.
    bends = fit != NO_FIT and bend > 0.0
    ratio = (a - b) / (bend if bends else 1.0)
    return ratio if bends else 0.0


@inlined
def lowest_rival(costs, at, start, stop, k):
    """The lowest cost of the candidates start..stop that are at least two away from the winner k; +inf if none is."""
    least = np.inf
    for j in range(start, k - 1):
        least = min(least, np.float64(costs[at + j]))
    for j in range(max(k + 2, start), stop):
        least = min(least, np.float64(costs[at + j]))
    return least


@inlined
def mask_row(costs, at, depth, start, stop, top):
    """Set the costs of the candidates outside start..stop of a pixel to `top`."""
    for chunk in range(0, depth, LANES):
        # Only chunks that contain candidates without a partner are rewritten.
        if start > chunk or stop < chunk + LANES:
            first = min(max(start - chunk, 0), LANES)
            last = min(max(stop - chunk, 0), LANES)
            kept = mask_outside(load(costs, at + chunk), first, last, top)
            store(costs, at + chunk, kept)


@inlined
def first_lowest(costs, at, depth, slack):
    """(least, k): the lowest cost of a pixel, and the first candidate whose cost is at most `slack` above it."""
    # First the minimum over chunks in each lane, then over the lanes.
    lanes = load(costs, at)
    for chunk in range(LANES, depth, LANES):
        lanes = min(lanes, load(costs, at + chunk))
    least = lowest(lanes)
    bound = least + slack
    chunk = 0
    while lowest(load(costs, at + chunk)) > bound:
        chunk += LANES
    return least, chunk + first_at_most(load(costs, at + chunk), bound)


@jit
def winners_of_row(costs, depth, low, count, fit, limits, best, rivals, disparity):
    """Write the winner of each pixel of a row.

    costs: flat (W, depth), depth a multiple of LANES; candidate j of pixel x is disparity low + j. The first `count`
    candidates are searched, and of these the ones with a partner in the image; the costs of others without a partner
    are overwritten. Costs from `count` on are `top`.
    limits: (slack, top) of the costs' dtype. The winner is the first candidate whose cost is at most `slack` above the
    lowest; `top` is the largest cost. disparity (W,) receives the winner with the sub-pixel fit, unless it is at an end
    of its pixel's range. best and rivals (W,) receive its cost and the lowest cost of a candidate at least two away;
    pass arrays of size 0 to skip them. Pixels without a candidate are left unchanged.
    """
    slack, top = limits
    width = len(disparity)
    for x in range(width):
        # The partner x - low - j is in the image for j from start to stop.
        start, stop = max(0, x - low - width + 1), min(count, x - low + 1)
        if start >= stop:
            continue
        at = x * depth
        if start > 0 or stop < count:
            mask_row(costs, at, depth, start, stop, top)
        # Of equal costs the smallest disparity wins.
        least, k = first_lowest(costs, at, depth, slack)
        offset = 0.0
        # At an end of the pixel's range one of the neighbours that the fit needs is missing.
        if start < k and k < stop - 1:
            offset = fitted(fit, costs[at + k - 1], costs[at + k], costs[at + k + 1])
        disparity[x] = low + k + offset
        if len(best) > 0:
            best[x] = least
            rivals[x] = lowest_rival(costs, at, start, stop, k)


@inlined
def write_winners(costs, depth, low, count, result, y):
    """`winners_of_row` into row y of the result: (fit, limits, best, rivals, disparity), with a row axis.

    best and rivals have no columns, and then maybe one row only, where they are not asked for.
    """
    fit, limits, best, rivals, disparity = result
    kept = min(y, len(best) - 1)
    winners_of_row(
        costs, depth, low, count, fit, limits, best[kept], rivals[kept], disparity[y]
    )


@jit
def winners_of_rows(volume, depth, low, count, fit, limits, best, rivals, disparity):
    """`winners_of_row` for each row of a flat (rows, W, depth) volume."""
    rows, width = disparity.shape
    result = fit, limits, best, rivals, disparity
    for y in range(rows):
        costs = volume[y * width * depth : (y + 1) * width * depth]
        write_winners(costs, depth, low, count, result, y)


@jit
def near_counts(costs, steps, out):
    """out (W,) = the number of pairs (candidate, step) with cost <= lowest cost of the pixel + step.

    costs (W, D), steps ascending, from 0: float32, and so are the sums. A candidate of cost +inf counts at every
    step.
    """
    width, depth = costs.shape
    bounds = np.zeros(len(steps), np.float32)
    for x in range(width):
        here = costs[x]
        least = np.float32(np.inf)
        for j in range(depth):
            least = min(least, here[j])
        for i in range(len(steps)):
            bounds[i] = least + steps[i]
        total = 0
        for j in range(depth):
            first = 0
            if here[j] != np.inf:
                while first < len(steps) and here[j] > bounds[first]:
                    first += 1
            total += len(steps) - first
        out[x] = total
