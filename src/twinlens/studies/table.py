"""A table of measurements: one named column per quantity, one row per measurement, stored as CSV.

`intervals` computes means and confidence intervals of its columns.
"""

import csv
import io
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from twinlens.errors import InputError, check_known
from twinlens.geometry import Float

Value = float | int | str
Row = Mapping[str, Value]


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
    """Columns, and rows with a value for each column: NaN or "" where nothing was measured.

    Raises InputError for a row whose columns are not those of the table.
    """

    columns: tuple[Column, ...]
    rows: tuple[Row, ...]

    def __post_init__(self) -> None:
        names = {column.name for column in self.columns}
        for number, row in enumerate(self.rows):
            if mismatched := names.symmetric_difference(row):
                raise InputError(
                    f"row {number} of the table does not fit its columns: {', '.join(sorted(mismatched))}"
                )

    def __len__(self) -> int:
        return len(self.rows)

    def __iter__(self) -> Iterator[Row]:
        return iter(self.rows)

    def column(self, name: str) -> Column:
        """The column of this name; InputError if there is none."""
        columns = {column.name: column for column in self.columns}
        check_known("column", name, columns)
        return columns[name]

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
        rows = self.rows
        if condition is not None:
            rows = tuple(row for row in rows if condition(row))
        for name, value in equal.items():
            self.column(name)
            allowed = (value,) if np.isscalar(value) else value
            rows = tuple(row for row in rows if row[name] in allowed)
        return Table(self.columns, rows)

    def groups(self, *names: str) -> Iterator[tuple[tuple[Value, ...], "Table"]]:
        """Groups of rows with equal values in these columns, in order of their first rows."""
        groups: dict[tuple[Value, ...], list[Row]] = {}
        for row in self.rows:
            key = tuple(row[name] for name in names)
            groups.setdefault(key, []).append(row)
        for key, rows in groups.items():
            yield key, Table(self.columns, tuple(rows))


def to_csv(table: Table) -> str:
    """The table as RFC 4180 text with newlines (LF) and nine significant digits, enough for float32.

    >>> print(to_csv(Table((Column("z_m", "m", "depth"),), ({"z_m": 2.5},))), end="")
    z_m
    2.5
    """
    names = [column.name for column in table.columns]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    for row in table.rows:
        writer.writerow([_cell(row[name]) for name in names])
    return text.getvalue()


def from_csv(text: str, columns: Sequence[Column]) -> Table:
    """The table that `to_csv` wrote. Cells that parse as numbers are numbers.

    Raises InputError if the header does not have the names of the columns.
    """
    lines = csv.reader(io.StringIO(text))
    header = next(lines, [])
    by_name = {column.name: column for column in columns}
    if sorted(header) != sorted(by_name):
        raise InputError(
            f"the CSV has the columns {', '.join(header)}; expected {', '.join(by_name)}"
        )
    rows = []
    for line in lines:
        values = [_value(cell) for cell in line]
        rows.append(dict(zip(header, values, strict=True)))
    return Table(tuple(by_name[name] for name in header), tuple(rows))


def filled_table(columns: Iterable[Column], rows: Sequence[Row]) -> Table:
    """A table of rows that may omit columns: "" is filled in columns of words, and NaN in others.

    Numbers are rounded as in the CSV, so that findings do not depend on whether the table was stored.
    """
    columns = tuple(columns)
    words: set[str] = set()
    for row in rows:
        words.update(name for name, value in row.items() if isinstance(value, str))
    empty = {
        column.name: "" if column.name in words else math.nan for column in columns
    }
    complete = tuple({**empty, **row} for row in rows)
    return from_csv(to_csv(Table(columns, complete)), columns)


def _cell(value: Value) -> str:
    return value if isinstance(value, str) else f"{float(value):.9g}"


def _value(cell: str) -> Value:
    try:
        return float(cell)
    except ValueError:
        return cell
