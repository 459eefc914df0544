"""What the findings say of the photographs themselves, measured at the true disparities; no matcher is asked."""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from twinlens.matching import grey
from twinlens.scoring import Pair, region_masks

SIDE = 9
Image = NDArray[np.float64]


def seen_at_the_truth(pair: Pair) -> tuple[Image, Image, NDArray[np.bool_]]:
    """The left image, the right one moved onto it by the true disparity, and where both are known.

    Known is a pixel all of whose SIDE x SIDE window is seen by both cameras. Grey levels, 0..255.
    """
    left, right = (grey(image).astype(np.float64) for image in (pair.im0, pair.im1))
    known = np.isfinite(pair.disp0) & region_masks(pair, ["nonocc"])["nonocc"]
    rows, columns = np.indices(left.shape, np.float64)
    there = columns - np.where(known, pair.disp0, 0)
    moved = ndimage.map_coordinates(right, [rows, there], order=1, mode="nearest")
    whole = ndimage.minimum_filter(known, SIDE, mode="constant", cval=0)
    return left, moved, whole


def correlation(pair: Pair) -> float:
    """The median correlation of SIDE x SIDE windows at their true partner: what ZNCC has to go by."""
    left, moved, whole = seen_at_the_truth(pair)

    def mean(image: Image) -> Image:
        return ndimage.uniform_filter(image, SIDE)

    covariance = mean(left * moved) - mean(left) * mean(moved)
    spread = (mean(left**2) - mean(left) ** 2) * (mean(moved**2) - mean(moved) ** 2)
    there = whole & (spread > 1e-6)
    return float(np.median(covariance[there] / np.sqrt(spread[there])))


def offset(pair: Pair) -> float:
    """The median of left minus right at true partners, in grey levels: how much brighter the left eye is."""
    left, moved, whole = seen_at_the_truth(pair)
    return float(np.median((left - moved)[whole]))
