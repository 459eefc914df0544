"""Naive loops over pixels and candidates, the references of the matching kernels."""

import functools

import numpy as np

MARGIN = 32
"""Pixels by which images are continued: windows and disparities reach less far beyond them."""


def _ratio(top: float, bottom: float, otherwise: float) -> float:
    return 1 - top / bottom if bottom > 0 else otherwise


def _zncc(a, b):
    if a.min() == a.max() or b.min() == b.max():
        return 1.0
    a, b = a - a.mean(), b - b.mean()
    return 1 - (a * b).sum() / np.sqrt((a * a).sum() * (b * b).sum())


def _birchfield_tomasi(a, b):
    """Of the values, the lowest and the highest of a pixel: the distance of each from the other's range."""
    (ours, our_low, our_high), (theirs, their_low, their_high) = a.T, b.T
    forward = np.maximum(0, np.maximum(ours - their_high, their_low - ours))
    backward = np.maximum(0, np.maximum(theirs - our_high, our_low - theirs))
    return np.minimum(forward, backward).sum()


WINDOW_COSTS = {
    "sad": lambda a, b: np.abs(a - b).sum(),
    "zsad": lambda a, b: np.abs((a - a.mean()) - (b - b.mean())).sum(),
    "ssd": lambda a, b: ((a - b) ** 2).sum(),
    "zssd": lambda a, b: a.size * ((a - b - (a - b).mean()) ** 2).sum(),
    "ncc": lambda a, b: _ratio(
        (a * b).sum(), np.sqrt((a * a).sum() * (b * b).sum()), 1.0
    ),
    "zncc": _zncc,
    "jaccard": lambda a, b: _ratio(np.minimum(a, b).sum(), np.maximum(a, b).sum(), 0.0),
    "census": lambda a, b: np.abs(a - b).sum(),
    "rank": lambda a, b: np.abs(a - b).sum(),
    "birchfield_tomasi": _birchfield_tomasi,
}
"""Costs of two windows of features, (side, side, C)."""


def naive_descriptors(image, side, name):
    """(H, W, side^2) 0 or 1: is the neighbour darker; or, for rank, (H, W, 1) how many are."""
    padded = np.pad(image, side // 2, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, (side, side))
    darker = (windows < image[:, :, None, None]).reshape(*image.shape, -1).astype(float)
    return darker if name == "census" else darker.sum(axis=2, keepdims=True)


def features(name, image, descriptor=3):
    """(H, W, C): what a cost compares of each pixel."""
    if name in ("census", "rank"):
        return naive_descriptors(image, descriptor, name)
    image = image.astype(float)
    if name != "birchfield_tomasi":
        return image[..., None]
    padded = np.pad(image, ((0, 0), (1, 1)), mode="edge")
    before = (image + padded[:, :-2]) / 2
    after = (image + padded[:, 2:]) / 2
    values = np.stack([image, before, after], axis=-1)
    return np.stack([image, values.min(axis=-1), values.max(axis=-1)], axis=-1)


def window_cost(name, left, right, descriptor=3, measure=None):
    """cost(y, x, d, side) of two windows; a place outside an image means its nearest edge pixel.

    measure: another function of two windows than that of the name.
    """
    margins = ((MARGIN, MARGIN), (MARGIN, MARGIN), (0, 0))
    padded_left, padded_right = (
        np.pad(features(name, image, descriptor), margins, mode="edge")
        for image in (left, right)
    )
    measure = measure or WINDOW_COSTS[name]

    @functools.cache
    def cost(y, x, d, side):
        top = y + MARGIN - side // 2
        first = x + MARGIN - side // 2
        rows = slice(top, top + side)
        ours = padded_left[rows, first : first + side]
        theirs = padded_right[rows, first - d : first - d + side]
        return measure(ours, theirs)

    return cost


def cost_volume(cost, shape, side, low, count):
    """(H, W, count): the costs of all disparities, also of those without a partner."""
    volume = np.empty((*shape, count))
    for y, x, i in np.ndindex(volume.shape):
        volume[y, x, i] = cost(y, x, low + i, side)
    return volume


def naive_volume(left, right, name, side, low, count, descriptor=3):
    """(H, W, count): the costs of the candidates; +inf elsewhere."""
    cost = window_cost(name, left, right, descriptor)
    volume = np.full((*left.shape, count), np.inf)
    for y, x, i in np.argwhere(is_candidate(left.shape, low, count)):
        volume[y, x, i] = cost(y, x, low + i, side)
    return volume


def is_candidate(shape, low, count):
    partner = np.arange(shape[1])[:, None] - low - np.arange(count)
    return np.broadcast_to((partner >= 0) & (partner < shape[1]), (*shape, count))


def naive_paths(costs, directions, small, large):
    """The sum of path costs (H, W, D), each path followed pixel by pixel from where it enters the image."""
    height, width = costs.shape[:2]
    total = np.zeros(costs.shape, int)
    for dy, dx in directions:
        # A path comes from (dy, dx): the pixels before are visited first.
        path = costs.astype(int)
        order = list(np.ndindex(height, width))
        if dy > 0 or (dy == 0 and dx > 0):
            order.reverse()
        for y, x in order:
            if not (0 <= y + dy < height and 0 <= x + dx < width):
                continue
            before = path[y + dy, x + dx].astype(float)
            padded = np.pad(before, 1, constant_values=np.inf)
            step = np.minimum(padded[:-2], padded[2:]) + small
            jump = before.min() + large
            best = np.minimum(np.minimum(before, step), jump)
            path[y, x] += (best - before.min()).astype(int)
        total += path
    return total


def naive_fit(volume, winners, kind):
    """The sub-pixel disparity index of each winner from its two neighbours, where both are candidates."""
    result = np.full(winners.shape, np.inf)
    beside = np.pad(volume, ((0, 0), (0, 0), (1, 1)), constant_values=np.inf)
    for (y, x), k in np.ndenumerate(winners):
        before, here, after = beside[y, x, k : k + 3]
        if not np.isfinite(here):
            continue
        result[y, x] = k
        if not np.isfinite(before + after):
            continue
        scale = before - 2 * here + after
        if kind == "v":
            scale = max(before, after) - here
        if scale > 0:
            result[y, x] += 0.5 * (before - after) / scale
    return result


def assert_minimal(volume, disparity, low, atol=1e-4, rtol=0.0):
    """The disparity is a candidate of least cost wherever there is a candidate, and unknown elsewhere."""
    least = volume.min(axis=-1)
    finite = np.isfinite(least)
    np.testing.assert_array_equal(np.isfinite(disparity), finite)
    index = np.where(finite, disparity - low, 0).astype(int)
    chosen = np.take_along_axis(volume, index[..., None], -1)[..., 0]
    np.testing.assert_allclose(chosen[finite], least[finite], atol=atol, rtol=rtol)


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


def naive_support(support, cost, levels, side, low, count):
    """The volume of cost(y, x, d, side) over a support, but the adaptive one; levels: both images in grey levels."""
    left, right = levels
    if support in ("fixed", "shiftable"):
        volume = cost_volume(cost, left.shape, side, low, count)
        if support == "fixed":
            return volume
        volume[~is_candidate(left.shape, low, count)] = np.inf
        return naive_shiftable(volume, side // 2)
    pixels = cost_volume(cost, left.shape, 1, low, count)
    if support == "cross":
        return naive_cross(pixels, left, side // 2)
    if support == "weighted":
        return naive_weighted(pixels, left, right, low, side // 2)
    return naive_guided(pixels, left, side // 2)
