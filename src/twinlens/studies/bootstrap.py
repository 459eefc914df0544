"""Confidence intervals by bootstrap over scenes.

Measurements of one scene are not independent, however many seeds it is rendered with. Whole scenes are resampled with
replacement (Davison and Hinkley, Bootstrap Methods and their Application, 1997, section 3.8); with a single scene, its
seeds are resampled. For n units the percentile interval is too narrow by sqrt((n - 1)/n) and by the ratio of the normal
to Student's t; its levels are widened accordingly (Hesterberg, What Teachers Should Know About the Bootstrap, The
American Statistician 69(4), 2015, "expanded percentile"). With two to four units the interval is their whole range; the
range of three covers the true median with probability 3/4.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr, stdtrit

from twinlens.seeds import generator
from twinlens.studies.table import Table, Value

Float = NDArray[np.float64]
Statistic = Callable[[Float], float]

DRAWS = 1000
LEVEL = 0.95
MIN_UNITS = 5
"""With fewer units an interval is reported as a range."""
_STREAM = 6


@dataclass(frozen=True)
class Interval:
    """An estimate and its confidence interval [low, high]; both ends are NaN for a single unit.

    units: the number of scenes or seeds resampled; 0 if unknown.
    """

    value: float
    low: float
    high: float
    units: int = 0

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
        if 0 < self.units < MIN_UNITS:
            return f"{value} (range of {self.units}: {brief(self.low)} to {brief(self.high)})"
        return f"{value} [{brief(self.low)}, {brief(self.high)}]"


def unsigned(of: Interval, above: str, below: str) -> tuple[Interval, str]:
    """The size of a difference and the word for its sign: `above` if it is >= 0 or NaN, otherwise `below`.

    >>> unsigned(Interval(-2.0, -3.0, 1.0, 3), "fewer", "more")
    (Interval(value=2.0, low=-1.0, high=3.0, units=3), 'more')
    """
    if of.value < 0:
        return Interval(-of.value, -of.high, -of.low, of.units), below
    return of, above


def brief(number: float) -> str:
    """Three significant digits, without an exponent from 1000 to 1e6.

    >>> brief(0.03512), brief(12345.6), brief(-2)
    ('0.0351', '12346', '-2')
    """
    return f"{number:.0f}" if 1000 <= abs(number) < 1e6 else f"{number:.3g}"


def mean(values: Float) -> float:
    return float(values.mean())


def bootstrap(statistic: Statistic, units: Sequence[ArrayLike], seed: int = 0) -> Interval:
    """The statistic of all measurements together, with its interval from resampling the units.

    units: one array of measurements per unit; NaN measurements are ignored.

    >>> bootstrap(mean, [[1.0], [2.0], [3.0]])
    Interval(value=2.0, low=1.0, high=3.0, units=3)
    """
    arrays = [clean[~np.isnan(clean)] for clean in (np.asarray(unit, np.float64).ravel() for unit in units)]
    arrays = [values for values in arrays if values.size]
    if not arrays:
        return Interval(math.nan, math.nan, math.nan)
    value = float(statistic(np.concatenate(arrays)))
    count = len(arrays)
    if count < 2:
        return Interval(value, math.nan, math.nan, 1)
    tail = float(ndtr(math.sqrt(count / (count - 1)) * stdtrit(count - 1, 0.5 - LEVEL / 2)))
    low, high = np.quantile(_resampled(statistic, arrays, seed), (tail, 1.0 - tail))
    return Interval(value, float(low), float(high), count)


def _resampled(statistic: Statistic, arrays: Sequence[Float], seed: int) -> Float:
    """The statistic of every resample; equal resamples are evaluated once."""
    picks = np.sort(generator(seed, _STREAM).integers(0, len(arrays), (DRAWS, len(arrays))), axis=1)
    distinct, counts = np.unique(picks, axis=0, return_counts=True)
    values = [float(statistic(np.concatenate([arrays[i] for i in pick]))) for pick in distinct]
    return np.repeat(np.array(values), counts)


def over_scenes(table: Table, measure: Callable[[Table], ArrayLike], statistic: Statistic = mean) -> Interval:
    """The statistic of `measure`, evaluated on the rows of each scene and seed, with its interval over scenes.

    With a single scene, the interval is over its seeds.
    """
    scenes: dict[Value, list[Float]] = {}
    for (scene, _), unit in table.groups("scene", "seed"):
        scenes.setdefault(scene, []).append(np.asarray(measure(unit), np.float64).ravel())
    found = list(scenes.values())
    return bootstrap(statistic, found[0] if len(found) == 1 else [np.concatenate(seeds) for seeds in found])


def mean_of(table: Table, name: str) -> Interval:
    """The mean of a column, with its interval over scenes."""
    return over_scenes(table, lambda unit: unit.numbers(name))


def paired_difference(table: Table, name: str, by: str, first: Value, second: Value) -> Interval:
    """Mean over scenes and seeds of: column `name` where `by` equals `first`, minus where it equals `second`."""

    def difference(unit: Table) -> Float:
        a, b = (unit.where(**{by: which}).numbers(name) for which in (first, second))
        return np.array([a.mean() - b.mean()]) if a.size and b.size else np.empty(0)

    return over_scenes(table, difference)


def log_slope(x: str, y: str) -> Callable[[Table], float]:
    """A function that fits the exponent p of y ~ x^p by least squares of the logarithms; NaN for fewer than two x."""

    def slope(unit: Table) -> float:
        across, up = unit.numbers(x), unit.numbers(y)
        known = (across > 0) & (up > 0) & np.isfinite(across) & np.isfinite(up)
        if np.unique(across[known]).size < 2:
            return math.nan
        return float(np.polyfit(np.log(across[known]), np.log(up[known]), 1)[0])

    return slope
