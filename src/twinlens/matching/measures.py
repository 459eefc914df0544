"""The measures as plain functions of two windows: two arrays of one shape in, one float out.

They compute in float64 straight from the formulas, so they are slow, exact, and what the image-sized kernels are held
against. A window is any array, of any shape; pixels are compared in place. a, b are the windows, n their size, and
a', b' the windows less their means. Distances are lower-is-better and 0 for equal windows; similarities are
higher-is-better and 1 for equal windows. Surveys: Hirschmueller and Scharstein, "Evaluation of stereo matching costs on
images with radiometric differences", PAMI 2009; Brown, Burschka and Hager, "Advances in computational stereo", 2003.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.errors import InputError

Window = NDArray[Any]


def _windows(w0: ArrayLike, w1: ArrayLike) -> tuple[Window, Window]:
    a, b = np.asarray(w0), np.asarray(w1)
    if a.shape != b.shape:
        raise InputError(f"the windows have shapes {a.shape} and {b.shape}; both must have one shape")
    if a.size == 0:
        raise InputError("the windows are empty; a measure needs at least one pixel")
    a, b = a.astype(np.float64), b.astype(np.float64)
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise InputError("a window holds NaN or infinity; every pixel must be finite")
    return a, b


def _centred(w0: ArrayLike, w1: ArrayLike) -> tuple[Window, Window]:
    a, b = _windows(w0, w1)
    return a - a.mean(), b - b.mean()


def sad(w0: ArrayLike, w1: ArrayLike) -> float:
    """Sum of absolute differences, sum |a - b|: a distance in [0, inf), invariant to nothing.

    >>> sad([[1, 2], [3, 4]], [[1, 2], [3, 7]])
    3.0
    """
    a, b = _windows(w0, w1)
    return float(np.abs(a - b).sum())


def ssd(w0: ArrayLike, w1: ArrayLike) -> float:
    """Sum of squared differences, sum (a - b)^2: a distance in [0, inf), invariant to nothing.

    >>> ssd([[1, 2], [3, 4]], [[1, 2], [3, 7]])
    9.0
    """
    a, b = _windows(w0, w1)
    return float(np.square(a - b).sum())


def zsad(w0: ArrayLike, w1: ArrayLike) -> float:
    """SAD of the mean-free windows, sum |a' - b'|: a distance in [0, inf), invariant to an offset of brightness.

    >>> zsad([1, 2, 3], [11, 12, 13])
    0.0
    """
    a, b = _centred(w0, w1)
    return float(np.abs(a - b).sum())


def zssd(w0: ArrayLike, w1: ArrayLike) -> float:
    """SSD of the mean-free windows, sum (a' - b')^2: a distance in [0, inf), invariant to an offset of brightness.

    >>> zssd([1, 2, 3], [11, 12, 13])
    0.0
    """
    a, b = _centred(w0, w1)
    return float(np.square(a - b).sum())


def _cosine(a: Window, b: Window) -> float:
    # Divided first: the product of two small norms underflows where each of them does not.
    norms = np.linalg.norm(a), np.linalg.norm(b)
    return float(np.sum((a / norms[0]) * (b / norms[1]))) if min(norms) > 0 else 0.0


def ncc(w0: ArrayLike, w1: ArrayLike) -> float:
    """Normalised cross-correlation, sum(a b) / sqrt(sum a^2 sum b^2): the cosine of the angle between the windows.

    A similarity in [-1, 1], and [0, 1] for images; invariant to gain. A window of zeros has no direction: 0.
    Often printed in the place of ZNCC, which subtracts the means first.

    >>> round(ncc([1, 2, 3], [2, 4, 6]), 12)
    1.0
    """
    return _cosine(*_windows(w0, w1))


def zncc(w0: ArrayLike, w1: ArrayLike) -> float:
    """Zero-mean NCC, sum(a' b') / sqrt(sum a'^2 sum b'^2): Pearson's correlation coefficient of the pixels.

    A similarity in [-1, 1], invariant to gain and offset. A constant window correlates with nothing: 0.

    >>> round(zncc([1, 2, 3], [11, 13, 15]), 12)
    1.0
    >>> zncc([1, 2, 3], [5, 5, 5])
    0.0
    """
    a, b = _windows(w0, w1)
    if np.ptp(a) == 0 or np.ptp(b) == 0:
        return 0.0
    return _cosine(a - a.mean(), b - b.mean())


def jaccard(w0: ArrayLike, w1: ArrayLike) -> float:
    """Weighted Jaccard similarity, sum min(a, b) / sum max(a, b), of windows without negative values.

    A similarity in [0, 1], invariant to nothing; two windows of zeros are equal: 1. With S = sum a + sum b it is
    (S - SAD) / (S + SAD). Source: Ioffe, "Improved consistent sampling, weighted minhash and L1 sketching", ICDM 2010.

    >>> jaccard([1, 2], [3, 2])
    0.6
    """
    a, b = _windows(w0, w1)
    if min(a.min(), b.min()) < 0:
        raise InputError("a window holds negative values; the Jaccard similarity is defined for values >= 0")
    union = np.maximum(a, b).sum()
    return float(np.minimum(a, b).sum() / union) if union > 0 else 1.0
