"""Confidence intervals by the bootstrap, whose units are scenes or whatever else is independent.

Measurements of one scene are not independent, so whole scenes are resampled (Davison and Hinkley, Bootstrap Methods and
their Application, 1997, section 3.8). Percentile intervals of n units are too narrow by sqrt((n - 1)/n) and by the
ratio of the normal distribution's quantile to Student's t. They are widened by these factors (Hesterberg, What Teachers
Should Know About the Bootstrap, The American Statistician 69(4), 2015, "expanded percentile"); with two to four units
they cover the whole range.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr, stdtrit

from twinlens.geometry import Float
from twinlens.seeds import generator

Statistic = Callable[[Float], float]

DRAWS = 1000
LEVEL = 0.95
MIN_UNITS = 5  # with fewer, an interval is reported as a range
_STREAM, _SECOND_STREAM = 6, 7


@dataclass(frozen=True)
class Interval:
    """An estimate and its confidence interval, NaN for a single unit.

    units: of resampling; 0 if unknown. scene: the only scene, if its repetitions are the units.
    """

    value: float
    low: float
    high: float
    units: int = 0
    scene: str = field(default="", repr=False, compare=False)

    def __neg__(self) -> "Interval":
        return replace(self, value=-self.value, low=-self.high, high=-self.low)

    def contains(self, limit: float) -> bool:
        """Whether the limit is in the interval; False without an interval, or if all units have the same value.

        >>> Interval(2.0, 1.0, 3.0).contains(3.0), Interval(2.0, 2.0, 2.0).contains(2.0)
        (True, False)
        """
        return self.low < self.high and self.low <= limit <= self.high

    def format(self, unit: str = "", show: Callable[[float], str] | None = None) -> str:
        """The value and its interval as text; `show` writes a number, `brief` by default.

        >>> Interval(2.5, 2.25, 2.75, 9).format("px"), Interval(2.5, 2.25, 2.75, 3).format("px")
        ('2.5 px [2.25, 2.75]', '2.5 px (range of 3: 2.25 to 2.75)')
        >>> Interval(math.nan, math.nan, math.nan).format("px")
        '(not measured)'
        """
        if math.isnan(self.value):
            return "(not measured)"
        show = show or brief
        value = f"{show(self.value)} {unit}".strip()
        if math.isnan(self.low):
            return value
        low, high = show(self.low), show(self.high)
        if 0 < self.units < MIN_UNITS:
            return f"{value} (range of {self.units}: {low} to {high})"
        return f"{value} [{low}, {high}]"


def brief(number: float) -> str:
    """Three significant digits, without an exponent from 1000 to 1e6.

    >>> brief(0.03512), brief(12345.6), brief(-2)
    ('0.0351', '12346', '-2')
    """
    return f"{number:.0f}" if 1000 <= abs(number) < 1e6 else f"{number:.3g}"


def mean(values: Float) -> float:
    """The arithmetic mean, as a `Statistic`."""
    return float(values.mean())


def bootstrap(
    statistic: Statistic, units: Sequence[ArrayLike], seed: int = 0
) -> Interval:
    """The statistic of all measurements, with its interval from resampling units, arrays in which NaN is ignored.

    >>> bootstrap(mean, [[1.0], [2.0], [3.0]])
    Interval(value=2.0, low=1.0, high=3.0, units=3)
    """
    measured = [_without_nan(unit) for unit in units]
    measured = [values for values in measured if values.size]
    count = len(measured)
    value = statistic(np.concatenate(measured)) if count else math.nan
    if count < 2:
        return Interval(value, math.nan, math.nan, count)
    draws = _draws(count, seed, _STREAM)
    # Few units have few distinct resamples (three units: ten), so equal ones are evaluated once. This makes the
    # usual studies 3 to 25 times faster than scipy.stats.bootstrap, which evaluates every draw.
    distinct, copies = np.unique(np.sort(draws, axis=1), axis=0, return_counts=True)
    resampled = [
        statistic(np.concatenate([measured[unit] for unit in draw]))
        for draw in distinct
    ]
    return _interval(value, np.repeat(resampled, copies), count)


def mean_of_units(units: Sequence[ArrayLike], seed: int = 0) -> Interval:
    """`bootstrap(mean, units)` for units (N,) without NaN, in a fiftieth of the time.

    >>> mean_of_units([[1.0], [2.0], [3.0]])
    Interval(value=2.0, low=1.0, high=3.0, units=3)
    """
    count = len(units)
    if count < 2:
        value = mean(np.asarray(units[0])) if count else math.nan
        return Interval(value, math.nan, math.nan, count)
    value = mean(np.concatenate(units))
    return _interval(value, _resampled_means(units, seed, _STREAM), count)


def difference_of_means(
    first: Sequence[ArrayLike], second: Sequence[ArrayLike], seed: int = 0
) -> Interval:
    """Mean of all values of `first` minus that of `second`, two sets of units (N,) that are resampled independently.

    The interval is widened for the smaller number of units.

    >>> difference_of_means([[4.0], [6.0]], [[1.0], [3.0]])
    Interval(value=3.0, low=1.0, high=5.0, units=2)
    """
    count = min(len(first), len(second))
    if not count:
        return Interval(math.nan, math.nan, math.nan)
    value = mean(np.concatenate(first)) - mean(np.concatenate(second))
    if count < 2:
        return Interval(value, math.nan, math.nan, count)
    resampled = _resampled_means(first, seed, _STREAM)
    resampled -= _resampled_means(second, seed, _SECOND_STREAM)
    return _interval(value, resampled, count)


def _resampled_means(units: Sequence[ArrayLike], seed: int, stream: int) -> Float:
    """The mean of all values of the units of each draw, (DRAWS,)."""
    draws = _draws(len(units), seed, stream)
    sums = np.array([np.sum(unit) for unit in units])
    sizes = np.array([np.size(unit) for unit in units])
    return np.asarray(sums[draws].sum(axis=1) / sizes[draws].sum(axis=1))


def _draws(count: int, seed: int, stream: int) -> NDArray[np.int64]:
    """Indices of the units of each draw, (DRAWS, count)."""
    return generator(seed, stream).integers(0, count, (DRAWS, count))


def _interval(value: float, resampled: Float, count: int) -> Interval:
    # The tail beyond Student's t quantile, scaled by sqrt(n / (n - 1)), under a normal distribution (Hesterberg 2015).
    quantile = math.sqrt(count / (count - 1)) * stdtrit(count - 1, 0.5 - LEVEL / 2)
    tail = float(ndtr(quantile))
    low, high = np.quantile(resampled, (tail, 1.0 - tail))
    return Interval(value, float(low), float(high), count)


def _without_nan(unit: ArrayLike) -> Float:
    values = np.asarray(unit, np.float64).ravel()
    return values[~np.isnan(values)]
