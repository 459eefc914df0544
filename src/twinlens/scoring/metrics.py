"""Error statistics: absolute errors in, percentages and pixels out. Knows no file, no mask and no protocol.

Every function takes `errors`, a 1-D float64 array of absolute errors in pixels, all finite. Percentages are 0 to 100.
A statistic of no pixel at all is NaN: it has no value, and 0 would look like a perfect one.
"""

import math

import numpy as np
from numpy.typing import NDArray

Errors = NDArray[np.float64]


def percent(count: int, total: int) -> float:
    """100 count / total.

    >>> percent(1, 4), percent(0, 0)
    (25.0, nan)
    """
    return 100.0 * count / total if total else math.nan


def bad_count(errors: Errors, threshold: float) -> int:
    """How many errors are greater than `threshold` pixels, strictly (Middlebury v3, ETH3D).

    >>> bad_count(np.array([0.5, 1.0, 1.5]), 1.0)
    1
    """
    return int(np.count_nonzero(errors > threshold))


def avgerr(errors: Errors) -> float:
    """The mean absolute error, in pixels.

    >>> avgerr(np.array([1.0, 3.0]))
    2.0
    """
    return float(errors.mean()) if errors.size else math.nan


def rms(errors: Errors) -> float:
    """The root of the mean squared error, in pixels.

    >>> rms(np.array([1.0, 7.0]))
    5.0
    """
    return math.sqrt(float(np.mean(errors * errors))) if errors.size else math.nan


def quantiles(errors: Errors, percents: tuple[int, ...]) -> dict[str, float]:
    """A_q: the error that q percent of the pixels stay below, sorted(errors)[floor(n q / 100)], in pixels.

    No interpolation between two errors; A50 of an even count is the upper of the two middle ones. The evaluator of
    ETH3D (two-view-evaluation, `ComputeMetrics`) defines its A50 ... A99 so; the public Middlebury v3 kit computes
    none, and the same rule serves both here. The index is floored in integers: 0.9 as a float is not nine tenths.

    >>> quantiles(np.array([4.0, 1.0, 3.0, 2.0]), (50, 99))
    {'A50': 3.0, 'A99': 4.0}
    """
    if not errors.size:
        return {f"A{q}": math.nan for q in percents}
    ranks = [errors.size * q // 100 for q in percents]
    ordered = np.partition(errors, sorted(set(ranks)))
    return {f"A{q}": float(ordered[rank]) for q, rank in zip(percents, ranks, strict=True)}


def kitti_outliers(errors: Errors, truth: Errors, pixels: float, share: float) -> int:
    """How many errors exceed `pixels` AND `share` of the true disparity, both strictly (KITTI 2015 D1).

    >>> kitti_outliers(np.array([4.0, 4.0, 2.0]), np.array([70.0, 90.0, 10.0]), 3.0, 0.05)
    1
    """
    return int(np.count_nonzero((errors > pixels) & (errors > share * np.abs(truth))))
