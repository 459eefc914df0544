"""Counts of candidates whose cost is near the lowest, for `matching.confidence`."""

import numpy as np

from twinlens.matching.kernels.compiling import jit


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
