"""Confidence intervals by resampling: how far a mean over scenes and seeds could be off, had others been drawn."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.studies.table import Table, Value

Float = NDArray[np.float64]

DRAWS = 1000
LEVEL = 0.95
_STREAM = 6


@dataclass(frozen=True)
class Interval:
    """An estimate and its confidence interval, [low, high]; of one unit alone both ends are NaN."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        if math.isnan(self.low):
            return f"{self.value:.3g}"
        return f"{self.value:.3g} [{self.low:.3g}, {self.high:.3g}]"


def bootstrap(statistic: Callable[[Float], float], units: Sequence[ArrayLike], seed: int = 0) -> Interval:
    """The statistic of all units' values together, with the percentile interval over resampled units.

    `units` are the things that could have been drawn otherwise, each an array of its measurements: whole units are
    drawn with replacement (a cluster bootstrap: what one scene gives is not independent). Efron and Tibshirani, An
    Introduction to the Bootstrap, 1993, chapter 13. NaN measurements are left out.

    >>> bootstrap(np.mean, [[1.0], [2.0], [3.0]]).value
    2.0
    """
    arrays = [clean[~np.isnan(clean)] for clean in (np.asarray(unit, np.float64).ravel() for unit in units)]
    arrays = [values for values in arrays if values.size]
    if not arrays:
        return Interval(math.nan, math.nan, math.nan)
    value = float(statistic(np.concatenate(arrays)))
    if len(arrays) < 2:
        return Interval(value, math.nan, math.nan)
    random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_STREAM,)))
    picks = random.integers(0, len(arrays), (DRAWS, len(arrays)))
    drawn = [float(statistic(np.concatenate([arrays[i] for i in pick]))) for pick in picks]
    low, high = np.nanquantile(drawn, [0.5 - LEVEL / 2, 0.5 + LEVEL / 2])
    return Interval(value, float(low), float(high))


def mean_of(table: Table, name: str, units: Sequence[str] = ("scene", "seed")) -> Interval:
    """The mean of a column, with its interval over scenes and seeds.

    A scene seen with two seeds counts as two units: the interval tells of other seeds and of scenes like these.
    """
    return bootstrap(_mean, [group.numbers(name) for _, group in table.groups(*units)])


def paired_difference(table: Table, name: str, by: str, first: Value, second: Value) -> Interval:
    """Mean of (value at `first` minus value at `second` of the column `by`), scene by scene and seed by seed."""
    differences = []
    for _, unit in table.groups("scene", "seed"):
        a, b = (unit.where(**{by: which}).numbers(name) for which in (first, second))
        if a.size and b.size:
            differences.append(np.array([a.mean() - b.mean()]))
    return bootstrap(_mean, differences)


def _mean(values: Float) -> float:
    return float(values.mean())
