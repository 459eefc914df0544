"""A tidy table: one row per measurement, one column per quantity, read and written as CSV.

Numbers are written with nine significant digits, enough for float32, and lines end with a newline: equal tables
give equal bytes on every platform.
"""

import csv
import io
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.errors import InputError, unknown

Value = float | int | str
Row = Mapping[str, Value]
Float = NDArray[np.float64]


@dataclass(frozen=True)
class Column:
    """A quantity: its name in the table, its unit ("" for none), and its description, used as an axis label."""

    name: str
    unit: str
    text: str

    @property
    def label(self) -> str:
        """The axis label.

        >>> Column("z_m", "m", "depth").label
        'depth (m)'
        """
        return f"{self.text} ({self.unit})" if self.unit else self.text


@dataclass(frozen=True)
class Table:
    """Columns and rows. Every row has every column, with NaN or "" where a quantity has no value.

    Raises InputError for a row with a missing or an unknown column.
    """

    columns: tuple[Column, ...]
    rows: tuple[Row, ...]

    def __post_init__(self) -> None:
        names = {column.name for column in self.columns}
        for number, row in enumerate(self.rows):
            if set(row) != names:
                odd = ", ".join(sorted(names ^ set(row)))
                raise InputError(f"row {number} of the table does not fit its columns: {odd}")

    def __len__(self) -> int:
        return len(self.rows)

    def __iter__(self) -> Iterator[Row]:
        return iter(self.rows)

    def column(self, name: str) -> Column:
        """The column of this name; InputError with the nearest known name."""
        found = next((column for column in self.columns if column.name == name), None)
        if found is None:
            raise unknown("column", name, [column.name for column in self.columns])
        return found

    def numbers(self, name: str) -> Float:
        """One column as float64 (rows,)."""
        self.column(name)
        return np.array([float(row[name]) for row in self.rows], np.float64)

    def values(self, name: str) -> list[Value]:
        """The distinct values of a column, in order of first occurrence."""
        self.column(name)
        return list(dict.fromkeys(row[name] for row in self.rows))

    def where(self, condition: Callable[[Row], bool] | None = None, /, **equal: Any) -> "Table":
        """The rows that satisfy the condition and have these values (one of them, for a tuple, list or set)."""
        for name in equal:
            self.column(name)

        def fits(row: Row) -> bool:
            return all(
                row[name] in wanted if isinstance(wanted, (tuple, list, set, frozenset)) else row[name] == wanted
                for name, wanted in equal.items()
            ) and (condition is None or condition(row))

        return Table(self.columns, tuple(row for row in self.rows if fits(row)))

    def groups(self, *names: str) -> Iterator[tuple[tuple[Value, ...], "Table"]]:
        """Groups of rows with equal values in these columns, in order of their first rows."""
        keys: dict[tuple[Value, ...], list[Row]] = {}
        for row in self.rows:
            keys.setdefault(tuple(row[name] for name in names), []).append(row)
        for key, rows in keys.items():
            yield key, Table(self.columns, tuple(rows))


def to_csv(table: Table) -> str:
    """The table as RFC 4180 text with lines that end in a newline.

    >>> print(to_csv(Table((Column("z_m", "m", "depth"),), ({"z_m": 2.5},))), end="")
    z_m
    2.5
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([column.name for column in table.columns])
    writer.writerows([_format(row[column.name]) for column in table.columns] for row in table.rows)
    return text.getvalue()


def from_csv(text: str, columns: Sequence[Column]) -> Table:
    """The table that `to_csv` wrote; cells that parse as numbers are numbers.

    Raises InputError if the header does not name these columns.
    """
    lines = csv.reader(io.StringIO(text))
    header = next(lines, [])
    known = {column.name: column for column in columns}
    if sorted(header) != sorted(known):
        raise InputError(f"the CSV has the columns {', '.join(header)}; expected {', '.join(known)}")
    rows = tuple({name: _parse(cell) for name, cell in zip(header, line, strict=True)} for line in lines)
    return Table(tuple(known[name] for name in header), rows)


def table(columns: Iterable[Column], rows: Sequence[Row]) -> Table:
    """A table with numbers rounded as in its CSV, and missing values filled: "" in columns of words, NaN elsewhere."""
    chosen = tuple(columns)
    words = {name for row in rows for name, value in row.items() if isinstance(value, str)}
    empty: dict[str, Value] = {column.name: "" if column.name in words else math.nan for column in chosen}
    full = ({**empty, **row} for row in rows)
    return Table(chosen, tuple({name: _parse(_format(value)) for name, value in row.items()} for row in full))


def _format(value: Value) -> str:
    return value if isinstance(value, str) else f"{float(value):.9g}"


def _parse(cell: str) -> Value:
    try:
        return float(cell)
    except ValueError:
        return cell
