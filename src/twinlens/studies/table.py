"""Tables of measurements, one named column per quantity, as CSV; means and confidence intervals of their columns.

Whole scenes are resampled, or the seeds of a single scene (Davison and Hinkley, Bootstrap Methods and their
Application, 1997, section 3.8). Percentile intervals of n units are too narrow by sqrt((n - 1)/n) and the ratio of the
normal to Student's t. They are widened by these factors (Hesterberg, What Teachers Should Know About the Bootstrap, The
American Statistician 69(4), 2015, "expanded percentile"); with two to four units they cover the whole range.
"""

import csv
import io
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr, stdtrit

from twinlens.errors import InputError, check_known
from twinlens.geometry import Float
from twinlens.seeds import generator

Value = float | int | str
Row = Mapping[str, Value]
Statistic = Callable[[Float], float]

DRAWS = 1000
LEVEL = 0.95
MIN_UNITS = 5  # with fewer an interval is reported as a range
_STREAM = 6


@dataclass(frozen=True)
class Column:
    """A quantity: its name, its unit ("" for none), and its description for axes."""

    name: str
    unit: str
    text: str

    @property
    def label(self) -> str:
        """The label of an axis, such as "depth (m)"."""
        return f"{self.text} ({self.unit})" if self.unit else self.text


@dataclass(frozen=True)
class Table:
    """Columns and rows; every row has every column, with NaN or "" where there is no value, or InputError is raised."""

    columns: tuple[Column, ...]
    rows: tuple[Row, ...]

    def __post_init__(self) -> None:
        names = {column.name for column in self.columns}
        for number, row in enumerate(self.rows):
            if odd := names ^ set(row):
                raise InputError(
                    f"row {number} of the table does not fit its columns: {', '.join(sorted(odd))}"
                )

    def __len__(self) -> int:
        return len(self.rows)

    def __iter__(self) -> Iterator[Row]:
        return iter(self.rows)

    def column(self, name: str) -> Column:
        """The column of this name; InputError if there is none."""
        known = {column.name: column for column in self.columns}
        check_known("column", name, known)
        return known[name]

    def numbers(self, name: str) -> Float:
        """One column as float64 (rows,)."""
        self.column(name)
        return np.array([float(row[name]) for row in self.rows], np.float64)

    def values(self, name: str) -> list[Value]:
        """The distinct values of a column, in order of first occurrence."""
        self.column(name)
        return list(dict.fromkeys(row[name] for row in self.rows))

    def where(
        self, condition: Callable[[Row], bool] | None = None, /, **equal: Any
    ) -> "Table":
        """The rows that satisfy the condition and have these values (one of them, for a tuple, list or set)."""
        wanted = {
            name: (value,) if np.isscalar(value) else value
            for name, value in equal.items()
        }
        for name in wanted:
            self.column(name)
        rows = (
            row
            for row in self.rows
            if all(row[name] in values for name, values in wanted.items())
        )
        return Table(
            self.columns,
            tuple(row for row in rows if condition is None or condition(row)),
        )

    def groups(self, *names: str) -> Iterator[tuple[tuple[Value, ...], "Table"]]:
        """Groups of rows with equal values in these columns, in order of their first rows."""
        keys: dict[tuple[Value, ...], list[Row]] = {}
        for row in self.rows:
            keys.setdefault(tuple(row[name] for name in names), []).append(row)
        for key, rows in keys.items():
            yield key, Table(self.columns, tuple(rows))


def to_csv(table: Table) -> str:
    """The table as RFC 4180 text with newlines (LF) and nine significant digits, enough for float32.

    >>> print(to_csv(Table((Column("z_m", "m", "depth"),), ({"z_m": 2.5},))), end="")
    z_m
    2.5
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([column.name for column in table.columns])
    for row in table.rows:
        values = (row[column.name] for column in table.columns)
        writer.writerow(
            [
                value if isinstance(value, str) else f"{float(value):.9g}"
                for value in values
            ]
        )
    return text.getvalue()


def from_csv(text: str, columns: Sequence[Column]) -> Table:
    """The table that `to_csv` wrote. Cells that parse as numbers are numbers. InputError if the columns are others."""
    lines = csv.reader(io.StringIO(text))
    header = next(lines, [])
    known = {column.name: column for column in columns}
    if sorted(header) != sorted(known):
        raise InputError(
            f"the CSV has the columns {', '.join(header)}; expected {', '.join(known)}"
        )
    rows = tuple(
        {name: _parse(cell) for name, cell in zip(header, line, strict=True)}
        for line in lines
    )
    return Table(tuple(known[name] for name in header), rows)


def table(columns: Iterable[Column], rows: Sequence[Row]) -> Table:
    """A table with numbers rounded as in its CSV. Missing values become "" in columns of words, NaN in others."""
    chosen = tuple(columns)
    words = {
        name for row in rows for name, value in row.items() if isinstance(value, str)
    }
    empty: dict[str, Value] = {
        column.name: "" if column.name in words else math.nan for column in chosen
    }
    return from_csv(
        to_csv(Table(chosen, tuple({**empty, **row} for row in rows))), chosen
    )


def _parse(cell: str) -> Value:
    try:
        return float(cell)
    except ValueError:
        return cell


@dataclass(frozen=True)
class Interval:
    """An estimate and its confidence interval, NaN for a single unit. units: of resampling; 0 if unknown."""

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


def brief(number: float) -> str:
    """Three significant digits, without an exponent from 1000 to 1e6.

    >>> brief(0.03512), brief(12345.6), brief(-2)
    ('0.0351', '12346', '-2')
    """
    return f"{number:.0f}" if 1000 <= abs(number) < 1e6 else f"{number:.3g}"


def mean(values: Float) -> float:
    return float(values.mean())


def bootstrap(
    statistic: Statistic, units: Sequence[ArrayLike], seed: int = 0
) -> Interval:
    """The statistic of all measurements, with its interval from resampling units, arrays in which NaN is ignored.

    >>> bootstrap(mean, [[1.0], [2.0], [3.0]])
    Interval(value=2.0, low=1.0, high=3.0, units=3)
    """
    flat = (np.asarray(unit, np.float64).ravel() for unit in units)
    arrays = [
        values[~np.isnan(values)] for values in flat if not np.isnan(values).all()
    ]
    count = len(arrays)
    value = statistic(np.concatenate(arrays)) if count else math.nan
    if count < 2:
        return Interval(value, math.nan, math.nan, count)
    picks = np.sort(generator(seed, _STREAM).integers(0, count, (DRAWS, count)), axis=1)
    distinct, copies = np.unique(
        picks, axis=0, return_counts=True
    )  # equal resamples are evaluated once
    resampled = [
        statistic(np.concatenate([arrays[i] for i in pick])) for pick in distinct
    ]
    tail = float(
        ndtr(math.sqrt(count / (count - 1)) * stdtrit(count - 1, 0.5 - LEVEL / 2))
    )
    low, high = np.quantile(np.repeat(resampled, copies), (tail, 1.0 - tail))
    return Interval(value, float(low), float(high), count)


def over_scenes(
    table: Table, measure: Callable[[Table], ArrayLike], statistic: Statistic = mean
) -> Interval:
    """The statistic of `measure`, applied to the rows of each scene and seed; interval over scenes, or one's seeds."""
    found = [
        [
            np.asarray(measure(unit), np.float64).ravel()
            for _, unit in part.groups("seed")
        ]
        for _, part in table.groups("scene")
    ]
    return bootstrap(
        statistic,
        found[0] if len(found) == 1 else [np.concatenate(seeds) for seeds in found],
    )


def mean_of(table: Table, name: str) -> Interval:
    """The mean of a column, with its interval over scenes."""
    return over_scenes(table, lambda unit: unit.numbers(name))


def paired_difference(
    table: Table, name: str, by: str, first: Value, second: Value
) -> Interval:
    """Mean of column `name` where `by` equals `first`, minus that where it equals `second`, over scenes and seeds."""

    def difference(unit: Table) -> Float:
        a, b = (unit.where(**{by: which}).numbers(name) for which in (first, second))
        return np.array([a.mean() - b.mean()]) if a.size and b.size else np.empty(0)

    return over_scenes(table, difference)


def log_slope(x: str, y: str) -> Callable[[Table], float]:
    """A function that fits the exponent p of y ~ x^p by linear regression of the logarithms; NaN for a single x."""

    def slope(unit: Table) -> float:
        across, up = unit.numbers(x), unit.numbers(y)
        known = (across > 0) & (up > 0) & np.isfinite(across) & np.isfinite(up)
        if np.unique(across[known]).size < 2:
            return math.nan
        return float(np.polyfit(np.log(across[known]), np.log(up[known]), 1)[0])

    return slope


def log_parabola_minimum(x: Float, y: Float) -> float:
    """The x of the least finite y, by a parabola in log x through it and its neighbours; not refined at the ends.

    >>> x = np.array([1.0, 2.0, 4.0, 8.0])
    >>> round(log_parabola_minimum(x, (np.log(x) - np.log(3.0)) ** 2), 3)
    3.0
    """
    order = np.argsort(x)
    x, y = x[order], y[order]
    k = int(np.argmin(np.where(np.isfinite(y), y, np.inf)))
    near = slice(k - 1, k + 2)
    if k in (0, len(x) - 1) or not np.isfinite(y[near]).all():
        return float(x[k])
    a, b, _ = np.polyfit(np.log(x[near]), y[near], 2)
    return (
        math.exp(np.clip(-b / (2 * a), *np.log(x[[k - 1, k + 1]])))
        if a > 0
        else float(x[k])
    )
