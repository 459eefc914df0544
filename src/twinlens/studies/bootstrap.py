"""Confidence intervals by resampling: how far a mean could be off, had other scenes been photographed.

What one scene gives is not independent, however many seeds it is photographed with: scenes are drawn whole, with
replacement (Davison and Hinkley, Bootstrap Methods and their Application, 1997, section 3.8). Where one scene is all,
its seeds are drawn. Of n units the percentile interval is too narrow, as sqrt((n - 1)/n) and as the normal beside
Student's t; its levels are widened to make up for both (Hesterberg, What Teachers Should Know About the Bootstrap, The
American Statistician 69(4), 2015, "expanded percentile"). Of two to four units that is their whole range, and no
resampling can say more: the range of three covers the true median three times in four.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr, stdtrit

from twinlens.studies.table import Table, Value

Float = NDArray[np.float64]
Statistic = Callable[[Float], float]

DRAWS = 1000
LEVEL = 0.95
LEAST_UNITS = 5
"""Of fewer an interval is said to be the range that it is."""
_STREAM = 6


@dataclass(frozen=True)
class Interval:
    """An estimate and its confidence interval, [low, high]; of one unit alone both ends are NaN.

    units: how many scenes or seeds it was drawn of; 0 where that is not known. Of few it is no interval of 95 %, but
    about the range of what each gave.
    """

    value: float
    low: float
    high: float
    units: int = 0

    def said(self, unit: str = "") -> str:
        """In words.

        >>> Interval(2.5, 2.25, 2.75, 9).said("px"), Interval(2.5, 2.25, 2.75, 3).said("px")
        ('2.5 px [2.25, 2.75]', '2.5 px (range of 3: 2.25 to 2.75)')
        >>> Interval(math.nan, math.nan, math.nan).said("px")
        '(not measured)'
        """
        if math.isnan(self.value):
            return "(not measured)"
        value = f"{brief(self.value)} {unit}".strip()
        if math.isnan(self.low):
            return value
        if 0 < self.units < LEAST_UNITS:
            return f"{value} (range of {self.units}: {brief(self.low)} to {brief(self.high)})"
        return f"{value} [{brief(self.low)}, {brief(self.high)}]"


def unsigned(of: Interval, above: str, below: str) -> tuple[Interval, str]:
    """A difference as a sentence says it that has a word for its sign: turned round, with `below`, where it is under 0.

    >>> unsigned(Interval(-2.0, -3.0, 1.0, 3), "fewer", "more")
    (Interval(value=2.0, low=-1.0, high=3.0, units=3), 'more')
    """
    if of.value < 0:
        return Interval(-of.value, -of.high, -of.low, of.units), below
    return of, above


def brief(number: float) -> str:
    """Three digits that count, and no exponent where five would do.

    >>> brief(0.03512), brief(12345.6), brief(-2)
    ('0.0351', '12346', '-2')
    """
    return f"{number:.0f}" if 1000 <= abs(number) < 1e6 else f"{number:.3g}"


def mean(values: Float) -> float:
    """The statistic of most findings."""
    return float(values.mean())


def bootstrap(statistic: Statistic, units: Sequence[ArrayLike], seed: int = 0) -> Interval:
    """The statistic of all units' values together, with its interval over the units that could have been drawn.

    `units`: each an array of its measurements; NaN measurements are left out.

    >>> bootstrap(mean, [[1.0], [2.0], [3.0]])
    Interval(value=2.0, low=1.0, high=3.0, units=3)
    """
    arrays = [clean[~np.isnan(clean)] for clean in (np.asarray(unit, np.float64).ravel() for unit in units)]
    arrays = [values for values in arrays if values.size]
    if not arrays:
        return Interval(math.nan, math.nan, math.nan)
    value = float(statistic(np.concatenate(arrays)))
    if len(arrays) < 2:
        return Interval(value, math.nan, math.nan, 1)
    low, high = np.quantile(_drawn(statistic, arrays, seed), _levels(len(arrays)))
    return Interval(value, float(low), float(high), len(arrays))


def _drawn(statistic: Statistic, arrays: Sequence[Float], seed: int) -> Float:
    """The statistic of every draw; equal draws are looked at once."""
    random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_STREAM,)))
    picks = np.sort(random.integers(0, len(arrays), (DRAWS, len(arrays))), axis=1)
    distinct, counts = np.unique(picks, axis=0, return_counts=True)
    values = [float(statistic(np.concatenate([arrays[i] for i in pick]))) for pick in distinct]
    return np.repeat(np.array(values), counts)


def _levels(units: int) -> tuple[float, float]:
    tail = float(ndtr(math.sqrt(units / (units - 1)) * stdtrit(units - 1, 0.5 - LEVEL / 2)))
    return tail, 1.0 - tail


def over_scenes(table: Table, measure: Callable[[Table], ArrayLike], statistic: Statistic = mean) -> Interval:
    """The statistic of what `measure` gives of each scene and seed's rows, with its interval over scenes.

    Over the seeds where one scene is all.
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
    """Mean of (value at `first` minus value at `second` of the column `by`), scene by scene and seed by seed."""

    def difference(unit: Table) -> Float:
        a, b = (unit.where(**{by: which}).numbers(name) for which in (first, second))
        return np.array([a.mean() - b.mean()]) if a.size and b.size else np.empty(0)

    return over_scenes(table, difference)


def log_slope(x: str, y: str) -> Callable[[Table], float]:
    """What measures the exponent p of y ~ x^p in a table's rows, by least squares of the logarithms; NaN of one x."""

    def slope(unit: Table) -> float:
        across, up = unit.numbers(x), unit.numbers(y)
        known = (across > 0) & (up > 0) & np.isfinite(across) & np.isfinite(up)
        if np.unique(across[known]).size < 2:
            return math.nan
        return float(np.polyfit(np.log(across[known]), np.log(up[known]), 1)[0])

    return slope
