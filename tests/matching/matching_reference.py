"""Naive loops over pixels and candidates, the references of the matching kernels."""

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
    "zsad": lambda a, b: np.abs((a - a.mean()) - (b - b.mean())).sum(),
    "ssd": lambda a, b: ((a - b) ** 2).sum(),
    "zssd": lambda a, b: a.size * ((a - b - (a - b).mean()) ** 2).sum(),
    "ncc": lambda a, b: _ratio(
        (a * b).sum(), np.sqrt((a * a).sum() * (b * b).sum()), 1.0
    ),
    "zncc": _zncc,
    "jaccard": lambda a, b: _ratio(np.minimum(a, b).sum(), np.maximum(a, b).sum(), 0.0),
}


def naive_descriptors(image, side, name):
    """(H, W, side^2) 0 or 1: is the neighbour darker; or, for rank, (H, W, 1) how many are."""
    radius = side // 2
    padded = np.pad(image, radius, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, (side, side))
    darker = (windows < image[:, :, None, None]).reshape(*image.shape, -1).astype(float)
    return darker if name == "census" else darker.sum(axis=2, keepdims=True)


def pixel_difference(name, left, right, descriptor):
    """difference(y, x, u) of one pixel of each image; places outside an image mean its nearest edge pixel."""
    width = left.shape[1]
    if name in ("census", "rank"):
        a, b = (naive_descriptors(image, descriptor, name) for image in (left, right))
        return lambda y, x, u: np.abs(a[y, x] - b[y, u]).sum()
    a, b = left.astype(float), right.astype(float)
    if name == "sad":
        return lambda y, x, u: abs(a[y, x] - b[y, u])

    def around(image, y, x):
        middle = image[y, x]
        before, after = image[y, max(x - 1, 0)], image[y, min(x + 1, width - 1)]
        values = (middle, (middle + before) / 2, (middle + after) / 2)
        return middle, min(values), max(values)

    def birchfield_tomasi(y, x, u):
        one, low, high = around(a, y, x)
        other, low2, high2 = around(b, y, u)
        return min(max(0, one - high2, low2 - one), max(0, other - high, low - other))

    return birchfield_tomasi


def naive_pixel_window_volume(left, right, name, side, low, count, descriptor=3):
    """(H, W, count): sums of pixel differences over windows, each pixel taken from the nearest in its image."""
    height, width = left.shape
    difference, radius = pixel_difference(name, left, right, descriptor), side // 2
    reach = range(-radius, radius + 1)
    volume = np.full((height, width, count), np.inf)
    for y, x, i in np.ndindex(volume.shape):
        u = x - low - i
        if 0 <= u < width:
            volume[y, x, i] = sum(
                difference(
                    np.clip(y + v, 0, height - 1),
                    np.clip(x + h, 0, width - 1),
                    np.clip(u + h, 0, width - 1),
                )
                for v in reach
                for h in reach
            )
    return volume


def naive_pixel_costs(left, right, low, count):
    """(H, W, count): absolute differences; a partner outside the image is its edge pixel."""
    columns = np.clip(
        np.arange(left.shape[1])[:, None] - low - np.arange(count), 0, left.shape[1] - 1
    )
    return np.abs(left[:, :, None].astype(float) - right[:, columns].astype(float))


def is_candidate(shape, low, count):
    partner = np.arange(shape[1])[:, None] - low - np.arange(count)
    return np.broadcast_to((partner >= 0) & (partner < shape[1]), (*shape, count))


def naive_paths(costs, directions, small, large):
    """The sum of path costs (H, W, D), each path followed pixel by pixel from where it enters the image."""
    height, width = costs.shape[:2]
    total = np.zeros(costs.shape, int)
    for dy, dx in directions:
        path = np.zeros(costs.shape, int)
        rows = (
            range(height)
            if dy < 0 or (dy == 0 and dx < 0)
            else range(height - 1, -1, -1)
        )
        columns = (
            range(width) if dy < 0 or (dy == 0 and dx < 0) else range(width - 1, -1, -1)
        )
        for y in rows:
            for x in columns:
                path[y, x] = costs[y, x]
                if not (0 <= y + dy < height and 0 <= x + dx < width):
                    continue
                before = path[y + dy, x + dx].astype(float)
                steps = [
                    before,
                    np.append(np.inf, before[:-1]) + small,
                    np.append(before[1:], np.inf) + small,
                ]
                path[y, x] += (
                    np.minimum(np.min(steps, axis=0), before.min() + large)
                    - before.min()
                ).astype(int)
        total += path
    return total


def naive_volume(left, right, name, side, low, count):
    """(H, W, count): the cost of every candidate over whole windows of edge-continued images; +inf: not a candidate."""
    cost, radius = WINDOW_COSTS[name], side // 2
    height, width = left.shape
    padded_left, padded_right = (
        np.pad(image.astype(np.float64), radius, mode="edge") for image in (left, right)
    )
    volume = np.full((height, width, count), np.inf)
    for y in range(height):
        for x in range(width):
            for i in range(count):
                u = x - low - i
                if 0 <= u < width:
                    window = padded_left[y : y + side, x : x + side]
                    volume[y, x, i] = cost(
                        window, padded_right[y : y + side, u : u + side]
                    )
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
            if not (
                0 < k < count - 1 and np.isfinite(volume[y, x, [k - 1, k + 1]]).all()
            ):
                continue
            before, here, after = volume[y, x, k - 1 : k + 2]
            if kind == "v":
                slope = max(before, after) - here
                result[y, x] += 0.5 * (before - after) / slope if slope > 0 else 0
            else:
                result[y, x] += (
                    0.5 * (before - after) / (before - 2 * here + after)
                    if before + after > 2 * here
                    else 0
                )
    return result


def assert_minimal(volume, disparity, low, atol=1e-4, rtol=0.0):
    """The disparity is a candidate of least cost wherever there is a candidate, and unknown elsewhere."""
    least = volume.min(axis=-1)
    known = np.isfinite(least)
    np.testing.assert_array_equal(np.isfinite(disparity), known)
    index = np.where(known, disparity - low, 0).astype(int)
    chosen = np.take_along_axis(volume, index[..., None], -1)[..., 0]
    np.testing.assert_allclose(chosen[known], least[known], atol=atol, rtol=rtol)


def first_minimum(volume, low):
    """The smallest disparity of least cost; +inf where there is no candidate."""
    return np.where(np.isfinite(volume.min(-1)), volume.argmin(-1) + low, np.inf)


def window(y, x, radius):
    return np.s_[
        max(0, y - radius) : y + radius + 1, max(0, x - radius) : x + radius + 1
    ]


def naive_shiftable(volume, radius):
    """The best window that contains the pixel."""
    best = np.empty_like(volume)
    for y, x in np.ndindex(volume.shape[:2]):
        best[y, x] = volume[window(y, x, radius)].min(axis=(0, 1))
    return best


def naive_arms(image, y, x, radius, contrast=20):
    """How far left, right, up and down the pixel's cross reaches."""
    result = []
    for dy, dx in ((0, -1), (0, 1), (-1, 0), (1, 0)):
        reach = 0
        while reach < radius:
            v, u = y + dy * (reach + 1), x + dx * (reach + 1)
            inside = 0 <= v < image.shape[0] and 0 <= u < image.shape[1]
            if not inside or abs(float(image[v, u]) - image[y, x]) > contrast:
                break
            reach += 1
        result.append(reach)
    return result


def naive_cross(costs, left, radius):
    """The mean over the horizontal arms of the pixels on the vertical arm."""
    volume = np.empty_like(costs)
    for y, x in np.ndindex(costs.shape[:2]):
        _, _, up, down = naive_arms(left, y, x, radius)
        region = []
        for v in range(y - up, y + down + 1):
            before, after, _, _ = naive_arms(left, v, x, radius)
            region += [costs[v, u] for u in range(x - before, x + after + 1)]
        volume[y, x] = np.mean(region, axis=0)
    return volume


def naive_weighted(costs, left, right, low, radius):
    """The mean weighted by similarity and proximity in both windows, with both gammas 12."""
    left, right = left.astype(float), right.astype(float)
    height, width = left.shape
    volume = np.empty_like(costs)
    for y, x, i in np.ndindex(costs.shape):
        u = int(np.clip(x - low - i, 0, width - 1))
        top = bottom = 0.0
        for v in range(max(0, y - radius), min(height, y + radius + 1)):
            for h in range(max(-radius, -x), min(radius, width - 1 - x) + 1):
                ours = abs(left[y, x] - left[v, x + h])
                theirs = abs(right[y, u] - right[v, int(np.clip(u + h, 0, width - 1))])
                weight = np.exp(-2 * np.hypot(v - y, h) / 12 - (ours + theirs) / 12)
                top, bottom = top + weight * costs[v, x + h, i], bottom + weight
        volume[y, x, i] = top / bottom
    return volume


def naive_guided(costs, left, radius):
    """The guided filter of a grey guide, with epsilon 1e-4."""

    def mean(values):
        out = np.empty_like(values)
        for y, x in np.ndindex(values.shape[:2]):
            out[y, x] = values[window(y, x, radius)].mean(axis=(0, 1))
        return out

    guide = left[:, :, None] / 255
    covariance = mean(costs * guide) - mean(guide) * mean(costs)
    slope = covariance / (mean(guide**2) - mean(guide) ** 2 + 1e-4)
    return mean(slope) * guide + mean(mean(costs) - slope * mean(guide))
