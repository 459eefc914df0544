"""Image statistics at the true disparities, for the findings of the frozen benchmark; no matcher is run."""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from twinlens.matching import grey
from twinlens.scoring import Pair, region_masks

SIDE = 9
Image = NDArray[np.float64]


def aligned_images(pair: Pair) -> tuple[Image, Image, NDArray[np.bool_]]:
    """The left image, the right image warped onto it by the true disparity, and a mask of valid pixels.

    A pixel is valid if all pixels of its SIDE x SIDE window are visible in both cameras. Grey levels, 0..255.
    """
    left, right = (grey(image).astype(np.float64) for image in (pair.im0, pair.im1))
    known = np.isfinite(pair.disp0) & region_masks(pair, ["nonocc"])["nonocc"]
    rows, columns = np.indices(left.shape, np.float64)
    source_columns = columns - np.where(known, pair.disp0, 0)
    warped = ndimage.map_coordinates(right, [rows, source_columns], order=1, mode="nearest")
    valid = ndimage.minimum_filter(known, SIDE, mode="constant", cval=0)
    return left, warped, valid


def correlation(pair: Pair) -> float:
    """The median correlation of SIDE x SIDE windows with their true matches, which is the score that ZNCC compares."""
    left, warped, valid = aligned_images(pair)

    def mean(image: Image) -> Image:
        return ndimage.uniform_filter(image, SIDE)

    covariance = mean(left * warped) - mean(left) * mean(warped)
    variances = (mean(left**2) - mean(left) ** 2) * (mean(warped**2) - mean(warped) ** 2)
    used = valid & (variances > 1e-6)
    return float(np.median(covariance[used] / np.sqrt(variances[used])))


def offset(pair: Pair) -> float:
    """The median of left minus right at true matches, in grey levels; positive if the left image is brighter."""
    left, warped, valid = aligned_images(pair)
    return float(np.median((left - warped)[valid]))
