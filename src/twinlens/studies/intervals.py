"""Estimates from a table with their confidence intervals: means, differences, exponents; the bootstrap behind them.

The rows of one scene are not independent, so whole scenes are resampled, or the seeds of a single scene (Davison and
Hinkley, Bootstrap Methods and their Application, 1997, section 3.8). Percentile intervals of n units are too narrow by
sqrt((n - 1)/n) and by the ratio of the normal distribution's quantile to Student's t. They are widened by these factors
(Hesterberg, What Teachers Should Know About the Bootstrap, The American Statistician 69(4), 2015, "expanded
percentile"); with two to four units they cover the whole range.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr, stdtrit

from twinlens.geometry import Float
from twinlens.seeds import generator
from twinlens.studies.table import Table, Value

Statistic = Callable[[Float], float]

DRAWS = 1000
LEVEL = 0.95
MIN_UNITS = 5  # with fewer, an interval is reported as a range
_STREAM = 6


@dataclass(frozen=True)
class Interval:
    """An estimate and its confidence interval, NaN for a single unit. units: of resampling; 0 if unknown."""

    value: float
    low: float
    high: float
    units: int = 0

    def __neg__(self) -> "Interval":
        return Interval(-self.value, -self.high, -self.low, self.units)

    def format(self, unit: str = "") -> str:
        """The value and its interval as text.

        >>> Interval(2.5, 2.25, 2.75, 9).format("px"), Interval(2.5, 2.25, 2.75, 3).format("px")
        ('2.5 px [2.25, 2.75]', '2.5 px (range of 3: 2.25 to 2.75)')
        >>> Interval(math.nan, math.nan, math.nan).format("px")
        '(not measured)'
        """
        if math.isnan(self.value):
            return "(not measured)"
        value = f"{brief(self.value)} {unit}".strip()
        if math.isnan(self.low):
            return value
        low, high = brief(self.low), brief(self.high)
        if 0 < self.units < MIN_UNITS:
            return f"{value} (range of {self.units}: {low} to {high})"
        return f"{value} [{low}, {high}]"


def brief(number: float) -> str:
    """Three significant digits, without an exponent from 1000 to 1e6.

    >>> brief(0.03512), brief(12345.6), brief(-2)
    ('0.0351', '12346', '-2')
    """
    return f"{number:.0f}" if 1000 <= abs(number) < 1e6 else f"{number:.3g}"


def is_above(measured: Interval, floor: float = 0.0) -> bool:
    """Whether a value and its interval, if it has one, are above the floor."""
    return measured.value > floor and not measured.low <= floor


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
    draws = generator(seed, _STREAM).integers(0, count, (DRAWS, count))
    # Few units have few distinct resamples (three units: ten), so equal ones are evaluated once. This makes the
    # usual studies 3 to 25 times faster than scipy.stats.bootstrap, which evaluates every draw.
    distinct, copies = np.unique(np.sort(draws, axis=1), axis=0, return_counts=True)
    resampled = [
        statistic(np.concatenate([measured[unit] for unit in draw]))
        for draw in distinct
    ]
    # The tail beyond Student's t quantile, scaled by sqrt(n / (n - 1)), under a normal distribution (Hesterberg 2015).
    quantile = math.sqrt(count / (count - 1)) * stdtrit(count - 1, 0.5 - LEVEL / 2)
    tail = float(ndtr(quantile))
    low, high = np.quantile(np.repeat(resampled, copies), (tail, 1.0 - tail))
    return Interval(value, float(low), float(high), count)


def _without_nan(unit: ArrayLike) -> Float:
    values = np.asarray(unit, np.float64).ravel()
    return values[~np.isnan(values)]


def over_scenes(
    table: Table, measure: Callable[[Table], ArrayLike], statistic: Statistic = mean
) -> Interval:
    """The statistic of `measure`, applied to the rows of each scene and seed; interval over scenes, or one's seeds."""
    scenes = []
    for _, scene in table.groups("scene"):
        measured = [measure(rows) for _, rows in scene.groups("seed")]
        scenes.append([np.asarray(values, np.float64).ravel() for values in measured])
    if len(scenes) == 1:
        return bootstrap(statistic, scenes[0])
    return bootstrap(statistic, [np.concatenate(seeds) for seeds in scenes])


def mean_of(table: Table, name: str) -> Interval:
    """The mean of a column, with its interval over scenes."""
    return over_scenes(table, lambda rows: rows.numbers(name))


def paired_difference(
    table: Table, name: str, by: str, first: Value, second: Value
) -> Interval:
    """Mean of column `name` where `by` equals `first`, minus that where it equals `second`, over scenes and seeds."""

    def difference(rows: Table) -> Float:
        minuend = rows.where(**{by: first}).numbers(name)
        subtrahend = rows.where(**{by: second}).numbers(name)
        if not minuend.size or not subtrahend.size:
            return np.empty(0)
        return np.array([minuend.mean() - subtrahend.mean()])

    return over_scenes(table, difference)


def log_slope(x: str, y: str) -> Callable[[Table], float]:
    """A function that fits the exponent p of y ~ x^p by linear regression of the logarithms; NaN for a single x."""

    def slope(rows: Table) -> float:
        abscissa, ordinate = rows.numbers(x), rows.numbers(y)
        usable = _has_logarithm(abscissa) & _has_logarithm(ordinate)
        abscissa, ordinate = abscissa[usable], ordinate[usable]
        if np.unique(abscissa).size < 2:
            return math.nan
        return float(np.polyfit(np.log(abscissa), np.log(ordinate), 1)[0])

    return slope


def _has_logarithm(values: Float) -> np.ndarray:
    return (values > 0) & np.isfinite(values)


def log_parabola_minimum(x: Float, y: Float) -> float:
    """The x of the least finite y, by a parabola in log x through it and its neighbours; not refined at the ends.

    >>> x = np.array([1.0, 2.0, 4.0, 8.0])
    >>> round(log_parabola_minimum(x, (np.log(x) - np.log(3.0)) ** 2), 3)
    3.0
    """
    order = np.argsort(x)
    x, y = x[order], y[order]
    least = int(np.argmin(np.where(np.isfinite(y), y, np.inf)))
    around = slice(least - 1, least + 2)
    if least in (0, len(x) - 1) or not np.isfinite(y[around]).all():
        return float(x[least])
    logarithms = np.log(x[around])
    curvature, slope, _ = np.polyfit(logarithms, y[around], 2)
    if curvature <= 0:
        return float(x[least])
    vertex = -slope / (2 * curvature)
    return math.exp(np.clip(vertex, logarithms[0], logarithms[2]))
