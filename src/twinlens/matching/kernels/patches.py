"""Patches of a disparity map: connected pixels whose neighbours differ little."""
# numba types what it compiles by itself; its decorators and the functions given to it carry no annotations
# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-any-return, misc"

import numpy as np

from twinlens.matching.kernels.compiling import jit


@jit
def patch_sizes(disparity, difference):
    """(H, W) how many pixels the patch of each pixel has; 0 where the disparity is +inf."""
    height, width = disparity.shape
    label = np.full((height, width), -1, np.int64)
    sizes = np.zeros(height * width + 1, np.int64)
    stack = np.empty(height * width, np.int64)
    for start in range(height * width):
        if label[start // width, start % width] >= 0 or not np.isfinite(disparity[start // width, start % width]):
            continue
        label[start // width, start % width] = start
        stack[0], waiting = start, 1
        while waiting > 0:
            waiting -= 1
            y, x = stack[waiting] // width, stack[waiting] % width
            sizes[start] += 1
            for side in range(4):
                v, u = y + (side == 0) - (side == 1), x + (side == 2) - (side == 3)
                if v < 0 or u < 0 or v >= height or u >= width or label[v, u] >= 0:
                    continue
                if np.isfinite(disparity[v, u]) and abs(disparity[v, u] - disparity[y, x]) <= difference:
                    label[v, u] = start
                    stack[waiting] = v * width + u
                    waiting += 1
    result = np.zeros((height, width), np.int64)
    for y in range(height):
        for x in range(width):
            if label[y, x] >= 0:
                result[y, x] = sizes[label[y, x]]
    return result
