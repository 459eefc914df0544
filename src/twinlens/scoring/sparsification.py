"""Sparsification: the error rate of the most confident pixels as a function of their share, and the area below it.

Source: Hu and Mordohai, "A quantitative evaluation of confidence measures for stereo vision", PAMI 34(11), 2012.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.errors import InputError

DENSITIES = tuple(k / 20 for k in range(1, 21))
"""The shares of pixels at which a curve is stored."""


@dataclass(frozen=True)
class Sparsification:
    """A sparsification curve. Rates and areas are fractions, 0 to 1; NaN without pixels.

    error_rates: the share of bad pixels among the most confident ones, at each of `DENSITIES`. auc: the area below the
    exact curve, from density 0 to 1. optimal_auc: that of a confidence that ranks every good pixel before every bad
    one, e + (1 - e) ln(1 - e) for the error rate e of all pixels. A random confidence has e.
    """

    error_rates: tuple[float, ...]
    auc: float
    optimal_auc: float


def sparsification(confidence: ArrayLike, bad: ArrayLike) -> Sparsification:
    """The sparsification curve of pixels with this confidence, higher is better; `bad` marks wrong pixels.

    Both have one shape. Pixels of equal confidence are kept in random order: within them, the curve is that of the
    expected number of bad pixels, so it does not depend on the order of the input.

    Raises InputError for different shapes, a `bad` that is not bool, and NaN.

    >>> curve = sparsification([0.9, 0.8, 0.3, 0.1], [False, False, False, True])
    >>> curve.error_rates[-1], round(curve.auc, 4), round(curve.optimal_auc, 4)
    (0.25, 0.0342, 0.0342)
    """
    values, wrong = np.asarray(confidence, np.float64).ravel(), np.asarray(bad)
    if wrong.dtype != np.bool_ or np.shape(confidence) != wrong.shape:
        what = f"{np.shape(confidence)} and {wrong.dtype} {wrong.shape}"
        raise InputError(
            f"confidence and bad have shapes {what}: expected one shape, and bad of bool"
        )
    if np.isnan(values).any():
        raise InputError("the confidence holds NaN: every pixel needs a number")
    if not values.size:
        return Sparsification((math.nan,) * len(DENSITIES), math.nan, math.nan)
    kept, faults = _counts_by_rank(values, wrong.ravel())
    counts = np.array(DENSITIES) * kept[-1]
    rates = np.interp(counts, kept, faults) / counts
    rate = float(faults[-1] / kept[-1])
    good = 1.0 - rate
    # The integral of max(0, 1 - good / share) over the share: bad pixels follow when all good ones are kept.
    optimal = rate + (good * math.log(good) if good > 0 else 0.0)
    return Sparsification(tuple(rates.tolist()), _area(kept, faults), optimal)


def _counts_by_rank(
    values: NDArray[np.float64], wrong: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(pixels kept, bad ones among them) after each group of equal confidence, from 0, most confident first."""
    _, group, sizes = np.unique(-values, return_inverse=True, return_counts=True)
    faults = np.bincount(group, weights=wrong, minlength=len(sizes))
    return np.append(0.0, np.cumsum(sizes)), np.append(0.0, np.cumsum(faults))


def _area(kept: NDArray[np.float64], faults: NDArray[np.float64]) -> float:
    """The integral of faults(k) / k over the share k / n, with faults(k) linear between the given points.

    On a piece faults = a + s k the integral is s (k1 - k0) + a ln(k1 / k0); a is 0 on the first one.
    """
    slopes = np.diff(faults) / np.diff(kept)
    starts = faults[1:] - slopes * kept[1:]
    logs = np.log(kept[2:] / kept[1:-1])
    return float((np.sum(np.diff(faults)) + np.sum(starts[1:] * logs)) / kept[-1])
