"""Costs of windows that are computed a strip of rows at a time."""

import numpy as np
from numpy.typing import NDArray

from twinlens.matching.box import BoxMatch, Rows, Volume, fill_sum
from twinlens.matching.images import Image, extended


def box_sums(boxes: tuple[BoxMatch, ...], offset: float) -> Rows:
    """The sum of the costs of several `BoxMatch` (a census of many bits has several words)."""

    def rows(start: int, stop: int) -> Volume:
        volume = np.empty((stop - start, boxes[0].shape[1], boxes[0].depth), np.float64)
        fill_sum(boxes, volume, start, 1.0, offset)
        return volume

    return rows


def birchfield_tomasi(left: Image, right: Image, side: int, low: int, depth: int) -> Rows:
    """Absolute differences that are insensitive to sampling, summed over windows.

    d(l, r) = max(0, min over the half-pixel neighbourhood): the least difference between one pixel and the other
    image interpolated half a pixel around its partner, taken both ways. Source: Birchfield and Tomasi, "A pixel
    dissimilarity measure that is insensitive to image sampling", PAMI 1998.
    """

    def rows(start: int, stop: int) -> Volume:
        from twinlens.matching.kernels.windows import birchfield_tomasi, window_sums

        radius, width = side // 2, left.shape[1]
        span, last = (start - radius, stop + radius), low + depth - 1
        ours = _bounds(left, span, (-radius, width + radius))
        theirs = _bounds(right, span, (-radius - last, width + radius - low))[:, :, ::-1]
        pixels = np.empty((stop - start + 2 * radius, width + 2 * radius, depth))
        birchfield_tomasi(ours, np.ascontiguousarray(theirs), width + 2 * radius - 1, pixels)
        volume = np.empty((stop - start, width, depth))
        window_sums(pixels, radius, np.empty((width + 2 * radius, depth)), volume)
        return volume

    return rows


def _bounds(image: Image, rows: tuple[int, int], columns: tuple[int, int]) -> Image:
    """(3, rows, columns): the image, its minimum and its maximum within half a pixel along the row, continued."""
    values = image.astype(np.float64)
    wide = np.pad(values, ((0, 0), (1, 1)), mode="edge")
    halves = (wide[:, :-2] + values) / 2, (values + wide[:, 2:]) / 2
    low, high = np.minimum(values, np.minimum(*halves)), np.maximum(values, np.maximum(*halves))
    return np.stack([extended(array, rows, columns) for array in (values, low, high)])


def zero_mean_absolute(left: Image, right: Image, side: int, low: int, depth: int) -> Rows:
    """ZSAD over windows, sum |(a - mean a) - (b - mean b)|; the means do not separate: W H D side^2 operations."""

    def means(padded: Image) -> NDArray[np.float64]:
        windows = np.lib.stride_tricks.sliding_window_view(padded, (side, side))
        return np.asarray(windows.mean(axis=(2, 3)))

    def rows(start: int, stop: int) -> Volume:
        from twinlens.matching.kernels.windows import zero_mean_absolute

        radius, width = side // 2, left.shape[1]
        span, last = (start - radius, stop + radius), low + depth - 1
        ours = extended(left, span, (-radius, width + radius)).astype(np.float64)
        theirs = extended(right, span, (-radius - last, width + radius - low)).astype(np.float64)
        reversed_means, theirs = (np.ascontiguousarray(array[:, ::-1]) for array in (means(theirs), theirs))
        volume = np.empty((stop - start, width, depth))
        # Reversed, candidate 0 of the window's first column is at `start`; its window's mean is 2 r columns before.
        places = width + 2 * radius - 1, width - 1
        zero_mean_absolute(ours, theirs, means(ours), reversed_means, *places, radius, volume)
        return volume

    return rows
