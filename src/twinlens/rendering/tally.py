"""The mean image of a ring over its passes, and how far it may be off."""

import math

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Camera
from twinlens.geometry import Float

FIXED_POINT = 2.0**32
"""Of a unit of radiance: sums are kept as whole numbers, which overflow beyond 4e9 units a pixel and pass."""


class RingMean:
    """Running mean of a ring's image over passes, each pixel over its own samples, and the spread between passes."""

    def __init__(self, camera: Camera) -> None:
        self.total = np.zeros((camera.height, camera.width, 3))
        self.count = np.zeros((camera.height, camera.width, 1))
        self.passes = np.zeros_like(self.count)  # in which a pixel got samples
        self.squares = np.zeros_like(self.total)

    def add(self, fixed: NDArray[np.uint64]) -> None:
        """One pass's fixed-point sums (H, W, 4)."""
        total = fixed[..., :3].astype(np.float64) / FIXED_POINT
        count = fixed[..., 3:].astype(np.float64)
        self.total += total
        self.count += count
        self.passes += count > 0
        self.squares += total**2 / np.maximum(count, 1.0)

    def image(self) -> Float:
        """The mean over all passes; a pixel that no sample reached takes its neighbours' mean."""
        mean = self.total / np.maximum(self.count, 1.0)
        empty = self.count[..., 0] == 0
        if empty.any():
            mean[empty] = _neighbours(self.total, self.count)[empty]
        return mean

    def standard_error(self) -> float:
        """Root mean square over the pixels with samples in several passes, from their variance; NaN without any.

        The variance of a mean of passes m_p of n_p samples is sum n_p (m_p - mean)^2 / ((passes - 1) sum n_p).
        """
        known = self.passes[..., 0] > 1
        if not known.any():
            return math.nan
        count, passes, total = self.count[known], self.passes[known], self.total[known]
        between = np.maximum(self.squares[known] - total**2 / count, 0.0)
        return math.sqrt(float((between / ((passes - 1) * count)).mean()))


def _neighbours(total: Float, count: Float) -> Float:
    """Mean over the 5x5 window of samples, 0 where even that is empty."""
    from scipy.ndimage import uniform_filter

    counts, totals = (np.asarray(uniform_filter(sums, size=(5, 5, 1))) for sums in (count, total))
    filled: Float = totals / np.where(counts > 1e-12, counts, np.inf)
    return filled
