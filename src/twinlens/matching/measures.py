"""The measures as plain functions of two windows: two arrays of one shape in, one float out.

The formulas are evaluated in float64. A window is an array of any shape. a, b are the windows, n is their size, and
a', b' are the windows minus their means. Distances are lower-is-better and 0 for equal windows; similarities are
higher-is-better and 1 for equal windows. Survey: Hirschmueller and Scharstein, "Evaluation of stereo matching costs on
images with radiometric differences", PAMI 2009. Raises InputError for windows of different shapes, or without pixels.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.errors import InputError

Window = NDArray[Any]


def _windows(
    w0: ArrayLike, w1: ArrayLike, *, centred: bool = False
) -> tuple[Window, Window]:
    a, b = np.asarray(w0), np.asarray(w1)
    if a.shape != b.shape:
        raise InputError(
            f"the windows have shapes {a.shape} and {b.shape}; both must have one shape"
        )
    if a.size == 0:
        raise InputError("the windows are empty; a measure needs at least one pixel")
    a, b = a.astype(np.float64), b.astype(np.float64)
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise InputError("a window holds NaN or infinity; every pixel must be finite")
    return (a - a.mean(), b - b.mean()) if centred else (a, b)


def sad(w0: ArrayLike, w1: ArrayLike) -> float:
    """Sum of absolute differences, sum |a - b|: a distance in [0, inf), not invariant.

    >>> sad([[1, 2], [3, 4]], [[1, 2], [3, 7]])
    3.0
    """
    a, b = _windows(w0, w1)
    return float(np.abs(a - b).sum())


def ssd(w0: ArrayLike, w1: ArrayLike) -> float:
    """Sum of squared differences, sum (a - b)^2: a distance in [0, inf), not invariant."""
    a, b = _windows(w0, w1)
    return float(np.square(a - b).sum())


def zsad(w0: ArrayLike, w1: ArrayLike) -> float:
    """SAD of the mean-free windows, sum |a' - b'|: a distance in [0, inf), invariant to an offset of brightness.

    >>> zsad([1, 2, 3], [11, 12, 13])
    0.0
    """
    a, b = _windows(w0, w1, centred=True)
    return float(np.abs(a - b).sum())


def zssd(w0: ArrayLike, w1: ArrayLike) -> float:
    """SSD of the mean-free windows, sum (a' - b')^2: a distance in [0, inf), invariant to an offset of brightness."""
    a, b = _windows(w0, w1, centred=True)
    return float(np.square(a - b).sum())


def _cosine(a: Window, b: Window) -> float:
    # Divide first: the product of two small norms may underflow.
    norms = np.linalg.norm(a), np.linalg.norm(b)
    return float(np.sum((a / norms[0]) * (b / norms[1]))) if min(norms) > 0 else 0.0


def ncc(w0: ArrayLike, w1: ArrayLike) -> float:
    """Normalised cross-correlation, sum(a b) / sqrt(sum a^2 sum b^2): the cosine of the angle between the windows.

    A similarity in [-1, 1], and [0, 1] for images; invariant to gain. 0 for a window of zeros.

    >>> round(ncc([1, 2, 3], [2, 4, 6]), 12)
    1.0
    """
    return _cosine(*_windows(w0, w1))


def zncc(w0: ArrayLike, w1: ArrayLike) -> float:
    """Zero-mean NCC, sum(a' b') / sqrt(sum a'^2 sum b'^2): Pearson's correlation coefficient of the pixels.

    A similarity in [-1, 1], invariant to gain and offset. 0 if a window is constant.

    >>> round(zncc([1, 2, 3], [11, 13, 15]), 12)
    1.0
    """
    if any(np.ptp(window) == 0 for window in _windows(w0, w1)):
        return 0.0
    return _cosine(*_windows(w0, w1, centred=True))


def jaccard(w0: ArrayLike, w1: ArrayLike) -> float:
    """Weighted Jaccard similarity, sum min(a, b) / sum max(a, b), of windows without negative values.

    A similarity in [0, 1], not invariant; two windows of zeros are equal: 1. With S = sum a + sum b it is
    (S - SAD) / (S + SAD). Source: Ioffe, "Improved consistent sampling, weighted minhash and L1 sketching", ICDM 2010.

    >>> jaccard([1, 2], [3, 2])
    0.6
    """
    a, b = _windows(w0, w1)
    if min(a.min(), b.min()) < 0:
        raise InputError(
            "a window holds negative values; the Jaccard similarity is defined for values >= 0"
        )
    union = np.maximum(a, b).sum()
    return float(np.minimum(a, b).sum() / union) if union > 0 else 1.0


def _darker(w0: ArrayLike, w1: ArrayLike) -> list[NDArray[np.bool_]]:
    """Of each window the mask of the pixels that are darker than the centre pixel."""
    a, b = _windows(w0, w1)
    if a.ndim != 2 or a.shape[0] % 2 == 0 or a.shape[1] % 2 == 0:
        raise InputError(
            f"the windows have shape {a.shape}; a window with a centre is 2-D, odd in height and width"
        )
    return [window < window[a.shape[0] // 2, a.shape[1] // 2] for window in (a, b)]


def census(w0: ArrayLike, w1: ArrayLike) -> float:
    """Hamming distance of the census descriptors: #{i : [a_i < a_c] != [b_i < b_c]}, a_c and b_c being the centres.

    A distance, whole, in [0, n - 1]; invariant to every strictly increasing change of brightness of either window (so
    to gain > 0, offset and gamma). Windows 2-D of odd height and width. Source: Zabih and Woodfill, "Non-parametric
    local transforms for computing visual correspondence", ECCV 1994.

    >>> census([[1, 5, 9]], [[90, 50, 10]])
    2.0
    """
    a, b = _darker(w0, w1)
    return float(np.count_nonzero(a != b))


def rank(w0: ArrayLike, w1: ArrayLike) -> float:
    """Difference of the ranks of the centres: |#{i : a_i < a_c} - #{i : b_i < b_c}|.

    A distance, whole, at most `census`; windows, invariances and source as of `census`.

    >>> rank([[1, 5, 9]], [[1, 5, 3]])
    1.0
    """
    a, b = _darker(w0, w1)
    return float(abs(np.count_nonzero(a) - np.count_nonzero(b)))


def birchfield_tomasi(w0: ArrayLike, w1: ArrayLike) -> float:
    """Sum of absolute differences, insensitive to sampling: sum min(d(a, b), d(b, a)).

    d(a, b) = max(0, a - max b~, min b~ - a), and b~ holds b and its linear interpolations half a pixel to the left
    and to the right, along the last axis, rows continued by their end pixels. A distance in [0, SAD]; not
    invariant to brightness, and 0 for linear ramps shifted against each other by up to half a pixel. Source:
    Birchfield and Tomasi, "A pixel dissimilarity measure that is insensitive to image sampling", PAMI 20(4), 1998.

    >>> birchfield_tomasi([0, 10, 20], [8, 18, 28])
    9.0
    """
    a, b = _windows(w0, w1)
    if a.ndim == 0:
        raise InputError(
            "the windows are single numbers; Birchfield-Tomasi needs rows of pixels"
        )
    distances = []
    for here, there in ((a, b), (b, a)):
        padded = np.concatenate([there[..., :1], there, there[..., -1:]], axis=-1)
        near = there, (there + padded[..., :-2]) / 2, (there + padded[..., 2:]) / 2
        above, below = here - np.max(near, axis=0), np.min(near, axis=0) - here
        distances.append(np.maximum(0, np.maximum(above, below)))
    return float(np.minimum(*distances).sum())
