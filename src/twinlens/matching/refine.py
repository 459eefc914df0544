"""Steps that refine a disparity map after the search.

Maps are (H, W) float32 in pixels, +inf where unknown, and are not changed in place. Density is the known fraction.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse

from twinlens.matching.images import Disparity, Image, levels

UNKNOWN = np.float32(np.inf)


def _kept(disparity: Disparity, keep: NDArray[np.bool_]) -> Disparity:
    return np.where(keep, disparity, UNKNOWN).astype(np.float32)


def consistent(left: Disparity, right: Disparity, tolerance: float) -> Disparity:
    """The left disparities whose partner in the right map agrees within `tolerance` pixels; the others become +inf.

    Each map is in its own image's pixels. The partner of (u, v) is the right map's pixel nearest to (u - d, v);
    if that is outside the image or unknown, the pixel becomes +inf. Density falls, mostly in occlusions.
    Source: Fua, "A parallel stereo algorithm that produces dense depth maps and preserves image features", 1993.
    """
    height, width = left.shape
    has_estimate = np.isfinite(left)
    partner = np.rint(np.arange(width) - np.where(has_estimate, left, 0.0)).astype(
        np.int64
    )
    inside = has_estimate & (partner >= 0) & (partner < width)
    rows, columns = np.arange(height)[:, None], np.clip(partner, 0, width - 1)
    at_partner = right[rows, columns]
    agree = inside & np.isfinite(at_partner)
    agree[agree] = np.abs(left[agree] - at_partner[agree]) <= tolerance
    return _kept(left, agree)


def unique(
    disparity: Disparity, cost: NDArray[Any], rival: NDArray[Any], percent: float
) -> Disparity:
    """Keep a pixel that costs less than its best rival by more than `percent`: cost < (1 - percent/100) rival.

    A rival is a candidate two or more disparities away; a pixel without one is kept.
    """
    return _kept(disparity, cost < (1.0 - percent / 100.0) * rival)


def with_texture(
    disparity: Disparity, image: Image, side: int, least: float
) -> Disparity:
    """Keep a pixel in whose window the RMS difference of neighbours in a row is at least `least` levels of 0..255."""
    grey = levels(image, image)[0].astype(np.float64)
    squares = np.square(np.diff(grey, axis=1, append=grey[:, -1:]))
    mean_square = ndimage.uniform_filter(squares, side, mode="nearest")
    return _kept(disparity, mean_square >= least**2)


def without_speckles(disparity: Disparity, size: int, difference: float) -> Disparity:
    """Set patches of fewer than `size` pixels to +inf; in a patch, neighbours (4) differ by at most `difference`."""
    # Patches are the connected components of a graph of pixels, with edges between similar neighbours.
    pixel = np.arange(disparity.size).reshape(disparity.shape)
    across = np.s_[:, :-1], np.s_[:, 1:]
    down = np.s_[:-1], np.s_[1:]
    starts, ends = [], []
    for before, after in (across, down):
        with np.errstate(invalid="ignore"):  # two unknown pixels: inf - inf
            similar = np.abs(disparity[before] - disparity[after]) <= difference
        starts.append(pixel[before][similar])
        ends.append(pixel[after][similar])
    edges = np.concatenate(starts), np.concatenate(ends)
    graph = sparse.coo_array(
        (np.ones(len(edges[0]), bool), edges), shape=(disparity.size,) * 2
    )
    _, labels = sparse.csgraph.connected_components(graph, directed=False)
    sizes = np.bincount(labels)[labels].reshape(disparity.shape)
    return _kept(disparity, sizes >= size)


def median(disparity: Disparity, side: int) -> Disparity:
    """The median of the known pixels in the window, at known pixels; of an even number, the lower. Density stays."""
    radius = side // 2
    padded = np.pad(disparity, radius, constant_values=UNKNOWN)
    windows = np.lib.stride_tricks.sliding_window_view(padded, (side, side))
    result = np.full(disparity.shape, UNKNOWN, np.float32)
    for y in range(len(disparity)):
        # Sorted, unknown pixels (+inf) come last, so the median of the known ones is at half their number.
        row = np.sort(windows[y].reshape(disparity.shape[1], -1), axis=1)
        middle = (np.isfinite(row).sum(axis=1) - 1) // 2
        result[y] = row[np.arange(len(row)), np.maximum(middle, 0)]
    return _kept(result, np.isfinite(disparity))


def filled(disparity: Disparity) -> Disparity:
    """Every unknown pixel takes the smaller (farther) of the nearest known ones left and right in its row.

    Occluded pixels are background. At a row's ends the only known neighbour is taken; a row without known pixels takes
    the nearest row that has some. Density becomes 1 unless no pixel is known.

    >>> filled(np.float32([[np.inf, 5, np.inf, 3, np.inf]]))
    array([[5., 5., 3., 3., 3.]], dtype=float32)
    """
    rows_known = np.flatnonzero(np.isfinite(disparity).any(axis=1))
    if not len(rows_known):
        return disparity.copy()
    from_left = carried_right(disparity)
    from_right = carried_right(disparity[:, ::-1])[:, ::-1]
    result = np.minimum(from_left, from_right)
    distances = np.abs(np.arange(len(result))[:, None] - rows_known)
    nearest = rows_known[distances.argmin(axis=1)]
    return np.asarray(result[nearest])


def carried_right(disparity: NDArray[Any]) -> NDArray[Any]:
    """Each unknown pixel (+inf) takes the nearest known one to its left in the row, if there is one."""
    # The running maximum of the known columns is the nearest one to the left.
    columns = np.where(np.isfinite(disparity), np.arange(disparity.shape[1]), 0)
    return np.take_along_axis(disparity, np.maximum.accumulate(columns, axis=1), axis=1)
