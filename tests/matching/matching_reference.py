"""Slow and plain: loops over pixels and candidates, which the kernels of the matching room are held against."""

from collections.abc import Callable

import numpy as np


def _ratio(top: float, bottom: float, otherwise: float) -> float:
    return 1 - top / bottom if bottom > 0 else otherwise


def _zncc(a, b):
    if a.min() == a.max() or b.min() == b.max():
        return 1.0
    a, b = a - a.mean(), b - b.mean()
    return 1 - (a * b).sum() / np.sqrt((a * a).sum() * (b * b).sum())


WINDOW_COSTS: dict[str, Callable[[np.ndarray, np.ndarray], float]] = {
    "sad": lambda a, b: np.abs(a - b).sum(),
    "ssd": lambda a, b: ((a - b) ** 2).sum(),
    "zssd": lambda a, b: a.size * ((a - b - (a - b).mean()) ** 2).sum(),
    "ncc": lambda a, b: _ratio((a * b).sum(), np.sqrt((a * a).sum() * (b * b).sum()), 1.0),
    "zncc": _zncc,
    "jaccard": lambda a, b: _ratio(np.minimum(a, b).sum(), np.maximum(a, b).sum(), 0.0),
}


def naive_volume(left, right, name, side, low, count):
    """(H, W, count): the cost of every candidate over whole windows of edge-continued images; +inf: not a candidate."""
    cost, radius = WINDOW_COSTS[name], side // 2
    height, width = left.shape
    padded_left, padded_right = (np.pad(image.astype(np.float64), radius, mode="edge") for image in (left, right))
    volume = np.full((height, width, count), np.inf)
    for y in range(height):
        for x in range(width):
            for i in range(count):
                u = x - low - i
                if 0 <= u < width:
                    window = padded_left[y : y + side, x : x + side]
                    volume[y, x, i] = cost(window, padded_right[y : y + side, u : u + side])
    return volume


def naive_fit(volume, winners, kind):
    """The sub-pixel disparity index of each winner from its two neighbours, where both are candidates."""
    height, width, count = volume.shape
    result = np.full((height, width), np.inf)
    for y in range(height):
        for x in range(width):
            k = winners[y, x]
            if not np.isfinite(volume[y, x, k]):
                continue
            result[y, x] = k
            if not (0 < k < count - 1 and np.isfinite(volume[y, x, [k - 1, k + 1]]).all()):
                continue
            before, here, after = volume[y, x, k - 1 : k + 2]
            if kind == "v":
                slope = max(before, after) - here
                result[y, x] += 0.5 * (before - after) / slope if slope > 0 else 0
            else:
                result[y, x] += 0.5 * (before - after) / (before - 2 * here + after) if before + after > 2 * here else 0
    return result
