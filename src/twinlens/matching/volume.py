"""Cost volumes, computed a strip of rows at a time."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twinlens.matching.box import BoxMatch, Volume, fill_sum
from twinlens.matching.images import Image, extended


@dataclass(frozen=True)
class BirchfieldTomasi:
    """Absolute differences that are insensitive to sampling, summed over windows.

    d(l, r) = max(0, min over the half-pixel neighbourhood): the least difference between one pixel and the other
    image interpolated half a pixel around its partner, taken both ways. Source: Birchfield and Tomasi, "A pixel
    dissimilarity measure that is insensitive to image sampling", PAMI 1998.
    """

    left: Image
    right: Image
    side: int
    low: int
    depth: int

    def fill(self, volume: Volume, y0: int) -> None:
        """Write the rows from y0 on of the window costs, (rows, W, depth); images are continued by their edges."""
        from twinlens.matching.kernels.volumes import birchfield_tomasi, window_sums

        radius, (rows, width, _) = self.side // 2, volume.shape
        span, last = (y0 - radius, y0 + rows + radius), self.low + self.depth - 1
        left = self._bounds(self.left, span, (-radius, width + radius))
        right = self._bounds(self.right, span, (-radius - last, width + radius - self.low))[:, :, ::-1]
        pixels = np.empty((rows + 2 * radius, width + 2 * radius, self.depth), volume.dtype)
        birchfield_tomasi(left, np.ascontiguousarray(right), width + 2 * radius - 1, pixels)
        window_sums(pixels, radius, np.empty((width + 2 * radius, self.depth)), volume)

    @staticmethod
    def _bounds(image: Image, rows: tuple[int, int], columns: tuple[int, int]) -> Image:
        """(3, rows, columns): the image, its minimum and its maximum within half a pixel along the row, continued."""
        values = image.astype(np.float64)
        wide = np.pad(values, ((0, 0), (1, 1)), mode="edge")
        halves = (wide[:, :-2] + values) / 2, (values + wide[:, 2:]) / 2
        low, high = np.minimum(values, np.minimum(*halves)), np.maximum(values, np.maximum(*halves))
        return np.stack([extended(array, rows, columns) for array in (values, low, high)])


@dataclass(frozen=True)
class ZeroMeanAbsolute:
    """ZSAD over windows, sum |(a - mean a) - (b - mean b)|; the means do not separate: W H D side^2 operations."""

    left: Image
    right: Image
    side: int
    low: int
    depth: int

    def fill(self, volume: Volume, y0: int) -> None:
        """Write the rows from y0 on of the window costs, (rows, W, depth)."""
        from twinlens.matching.kernels.volumes import zero_mean_absolute

        radius, (rows, width, _) = self.side // 2, volume.shape
        span, last = (y0 - radius, y0 + rows + radius), self.low + self.depth - 1
        left = extended(self.left, span, (-radius, width + radius)).astype(np.float64)
        right = extended(self.right, span, (-radius - last, width + radius - self.low)).astype(np.float64)
        means = [self._means(image) for image in (left, right)]
        right, right_means = (np.ascontiguousarray(array[:, ::-1]) for array in (right, means[1]))
        # Reversed, candidate 0 of the window's first column is at `start`; its window's mean is 2 r columns before.
        start = width + 2 * radius - 1
        zero_mean_absolute(left, right, means[0], right_means, start, width - 1, radius, volume)

    def _means(self, padded: Image) -> NDArray[np.float64]:
        windows = np.lib.stride_tricks.sliding_window_view(padded, (self.side, self.side))
        return np.asarray(windows.mean(axis=(2, 3)))


@dataclass(frozen=True)
class BoxCosts:
    """Window costs of one or several `BoxMatch`, added up (a census of many bits has several words)."""

    boxes: tuple[BoxMatch, ...]
    offset: float = 0.0

    def fill(self, volume: Volume, y0: int) -> None:
        """Write the rows from y0 on of the costs, (rows, W, depth)."""
        fill_sum(self.boxes, volume, y0, 1.0, self.offset)


Costs = BoxCosts | BirchfieldTomasi | ZeroMeanAbsolute
