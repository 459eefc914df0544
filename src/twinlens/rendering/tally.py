"""The mean image of a sheaf of paths over its passes, at each focus, and how far it may be off."""

import math

import numpy as np
from numpy.typing import NDArray

from twinlens.geometry import Float


class SheafMean:
    """Running means over passes, and their doubt, for each focus.

    The doubt is read off two halves of each pass: were they independent, means a and b of n_a and n_b samples would
    give the pass's mean the variance n_a n_b / n^2 (a - b)^2 in expectation. They are parts of one stratified pattern,
    whose errors partly cancel, so it is an upper bound: exact for noise, twice the variance where strata do best.
    """

    def __init__(self, focuses: int, height: int, width: int) -> None:
        self.total = np.zeros((focuses, 3, height, width))
        self.doubt = np.zeros_like(self.total)
        self.count = 0
        self.known = True

    def add(self, halves: NDArray[np.floating], counts: tuple[int, int]) -> None:
        """Sums of one pass, (2, F, 3, H, W), over so many samples each."""
        first, second = counts
        self.total += halves[0] + halves[1]
        self.count += first + second
        if not (first and second):
            self.known = False
            return
        self.doubt += first * second * (halves[0] / first - halves[1] / second) ** 2

    def image(self, focus: int) -> Float:
        """(H, W, 3)."""
        mean: Float = np.moveaxis(self.total[focus] / self.count, 0, -1)
        return mean

    def variance(self, focus: int) -> float:
        """Mean over the pixels and channels whose radiance is finite; NaN where one sample was all."""
        if not self.known:
            return math.nan
        doubt = self.doubt[focus]
        finite = np.isfinite(doubt)
        return float(doubt[finite].mean()) / self.count**2 if finite.any() else math.nan
