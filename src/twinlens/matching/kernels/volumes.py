"""Costs that are not box sums of a simple term: Birchfield-Tomasi and ZSAD, and window sums of pixel costs.

A volume is (rows, W, depth), the candidate's index last. Right images are reversed, as in `slide`.
"""
# Numba infers the types of what it compiles; its decorators and the functions given to them carry no annotations.
# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-any-return, misc"

import numpy as np

from twinlens.matching.kernels.compiling import jit


@jit
def birchfield_tomasi(left, right, start, volume):
    """volume[y, x, j] of left and right (3, rows, columns): the image, its minimum and maximum within half a pixel.

    Candidate j of column x is the column start - x + j of the reversed right images.
    """
    rows, width, depth = volume.shape
    for y in range(rows):
        for x in range(width):
            here, low, high = left[0, y, x], left[1, y, x], left[2, y, x]
            there = right[:, y, start - x : start - x + depth]
            out = volume[y, x]
            for j in range(depth):
                ours = max(here - there[2, j], there[1, j] - here)
                theirs = max(there[0, j] - high, low - there[0, j])
                out[j] = max(min(ours, theirs), 0)


@jit
def zero_mean_absolute(left, right, left_mean, right_mean, start, mean_start, radius, volume):
    """volume[y, x, j] = sum |(a - mean a) - (b - mean b)| over the window; images padded, the right ones reversed."""
    rows, width, depth = volume.shape
    side = 2 * radius + 1
    for y in range(rows):
        for x in range(width):
            out = volume[y, x]
            out[:] = 0
            means = right_mean[y, mean_start - x : mean_start - x + depth]
            for i in range(side):
                for k in range(side):
                    a = left[y + i, x + k] - left_mean[y, x]
                    there = right[y + i, start - x - k : start - x - k + depth]
                    for j in range(depth):
                        out[j] += abs(a - (there[j] - means[j]))


@jit
def window_sums(padded, radius, total, out):
    """out (rows, W, depth): sums over whole windows of padded (rows + 2 r, W + 2 r, depth).

    total (W + 2 r, depth), float64: scratch.
    """
    rows, width, depth = out.shape
    running = np.zeros(depth, np.float64)
    total[:] = 0.0
    for y in range(-2 * radius, rows):
        for x in range(width + 2 * radius):
            column, new = total[x], padded[y + 2 * radius, x]
            for j in range(depth):
                column[j] += new[j]
            if y > 0:
                old = padded[y - 1, x]
                for j in range(depth):
                    column[j] -= old[j]
        if y < 0:
            continue
        running[:] = 0.0
        for x in range(2 * radius):
            running += total[x]
        for x in range(width):
            enters, leaves, here = total[x + 2 * radius], total[x], out[y, x]
            for j in range(depth):
                running[j] += enters[j]
                here[j] = running[j]
                running[j] -= leaves[j]
