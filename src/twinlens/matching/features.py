"""Matches of single points that use no calibration: they show whether a pair is what its calibration says."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.errors import InputError
from twinlens.matching.images import grey

Points = NDArray[np.float64]
MAX_RATIO = 0.7
"""A match is kept if its descriptor is nearer than this times the second nearest (Lowe, 2004: 0.8 removes 90 % of the
false matches)."""
_DOUBLED_PIXELS = 500_000  # of the largest image that is doubled
_ENOUGH_PIXELS = 150_000  # for hundreds of matches, in about a second
_SAME_ROW = 2.0  # pixels
_LEAST_SIDE = 32  # pixels; SIFT needs an octave


def feature_matches(left: NDArray[Any], right: NDArray[Any]) -> tuple[Points, Points]:
    """Pixels (N, 2) of the left and of the right image that show the same points, by SIFT, most distinct first.

    left, right: uint8 or uint16 (H, W) or (H, W, 3), of any sizes. No calibration is used, so that the matches can test
    one. Some may be wrong. Deterministic. Raises InputError if an image has less than 32 rows or columns.
    Source: Lowe, "Distinctive image features from scale-invariant keypoints", IJCV 60 (2004).
    """
    from skimage.feature import match_descriptors  # 0.3 s, which --help does not need

    (points_a, words_a), (points_b, words_b) = _described(left), _described(right)
    if not len(points_a) or not len(points_b):
        return np.empty((0, 2)), np.empty((0, 2))
    pairs = match_descriptors(words_a, words_b, cross_check=True, max_ratio=MAX_RATIO)
    distances = np.linalg.norm(
        words_a[pairs[:, 0]].astype(float) - words_b[pairs[:, 1]], axis=1
    )
    pairs = pairs[np.argsort(distances, kind="stable")]
    return points_a[pairs[:, 0]], points_b[pairs[:, 1]]


def disparities_of_features(
    left: NDArray[Any], right: NDArray[Any]
) -> NDArray[np.float64]:
    """Disparities (N,) of matching features of a rectified pair, u_left - u_right in pixels, of either sign.

    left, right: as in `feature_matches`; images of more than 150 000 pixels are reduced first. Matches that are not in
    the same row are left out. Empty where the images have no texture, or less than 32 rows or columns.
    """
    factor = math.ceil(math.sqrt(left.shape[0] * left.shape[1] / _ENOUGH_PIXELS))
    small = [_reduced(image, factor) for image in (left, right)]
    if min(small[0].shape[:2]) < _LEAST_SIDE:
        return np.empty(0)
    here, there = feature_matches(*small)
    same_row = np.abs(here[:, 1] - there[:, 1]) <= _SAME_ROW
    return np.asarray(factor * (here[same_row, 0] - there[same_row, 0]))


def _reduced(image: NDArray[Any], factor: int) -> NDArray[Any]:
    """The grey image in which each pixel is the mean of `factor` x `factor`; the last rows and columns may be cut."""
    levels = grey(image)
    height, width = (size // factor for size in levels.shape)
    cut = levels[: height * factor, : width * factor]
    means = cut.reshape(height, factor, width, factor).mean(axis=(1, 3))
    return np.asarray(np.rint(means), dtype=levels.dtype)


def _described(image: NDArray[Any]) -> tuple[Points, NDArray[Any]]:
    """Keypoints (N, 2) as (u, v) and their descriptors (N, 128) of an image; none in a flat one."""
    from skimage.feature import SIFT

    height, width = image.shape[:2]
    if min(height, width) < _LEAST_SIDE:
        raise InputError(
            f"an image has {width} x {height} pixels; matches of features need {_LEAST_SIDE} x {_LEAST_SIDE}"
        )
    # The doubled image has the finest features, of which large images have enough; it takes four times as long.
    sift = SIFT(upsampling=2 if height * width <= _DOUBLED_PIXELS else 1)
    levels = grey(image) / np.iinfo(image.dtype).max
    try:
        sift.detect_and_extract(levels)
    except RuntimeError:  # scikit-image raises it where there are no features
        return np.empty((0, 2)), np.empty((0, 128))
    return sift.positions[:, ::-1].astype(np.float64), sift.descriptors
