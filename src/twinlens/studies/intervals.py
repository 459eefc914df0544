"""Estimates from a table with their confidence intervals over scenes: means, differences, exponents.

The rows of one scene are not independent, so whole scenes are resampled, or the seeds of a single scene
(`scoring.intervals`).
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from twinlens.geometry import Float
from twinlens.scoring.intervals import Interval, Statistic, bootstrap, mean
from twinlens.studies.table import Table, Value


def is_above(measured: Interval, floor: float = 0.0) -> bool:
    """Whether a value and its interval, if it has one, are above the floor."""
    return measured.value > floor and not measured.low <= floor


def over_scenes(
    table: Table, measure: Callable[[Table], ArrayLike], statistic: Statistic = mean
) -> Interval:
    """The statistic of `measure`, applied to the rows of each scene and seed; interval over scenes, or one's seeds."""
    scenes = []
    for _, scene in table.groups("scene"):
        measured = [measure(rows) for _, rows in scene.groups("seed")]
        scenes.append([np.asarray(values, np.float64).ravel() for values in measured])
    if len(scenes) == 1:
        name = str(table.rows[0]["scene"])
        return replace(bootstrap(statistic, scenes[0]), scene=name)
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
