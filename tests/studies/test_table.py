"""Tables: CSV round trips, missing values, selection, errors."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from twinlens.errors import InputError
from twinlens.studies import Column, Table, from_csv, to_csv
from twinlens.studies.table import filled_table

COLUMNS = (Column("name", "", "what"), Column("z_m", "m", "depth"))
WORDS = st.text(
    st.characters(codec="utf-8", exclude_categories=("Cs", "Cc")), min_size=1
).map(lambda word: f"w{word}")


@given(st.lists(st.tuples(WORDS, st.floats(allow_nan=True, allow_infinity=True))))
def test_csv_round_trip(rows):
    text = to_csv(
        Table(COLUMNS, tuple({"name": word, "z_m": value} for word, value in rows))
    )
    assert to_csv(from_csv(text, COLUMNS)) == text


@given(st.lists(st.floats(width=32, allow_nan=False, allow_infinity=False), min_size=1))
def test_nine_digits_preserve_float32(values):
    rows = tuple({"name": "a", "z_m": value} for value in values)
    back = from_csv(to_csv(Table(COLUMNS, rows)), COLUMNS).numbers("z_m")
    assert np.array_equal(np.float32(back), np.float32(values))


def test_quotes_and_values_that_are_not_finite_in_a_file():
    rows = ({"name": 'a,"b"', "z_m": 1}, {"name": "", "z_m": math.nan}, {"name": "x", "z_m": -math.inf})  # fmt: skip
    text = 'name,z_m\n"a,""b""",1\n,nan\nx,-inf\n'
    assert to_csv(Table(COLUMNS, rows)) == text


def test_other_columns_are_refused():
    with pytest.raises(InputError, match="did you mean 'z_m'"):
        Table(COLUMNS, ()).numbers("z_mm")
    with pytest.raises(InputError, match="expected name, z_m"):
        from_csv("name,depth\na,1\n", COLUMNS)


def test_missing_values_are_filled():
    filled = filled_table(COLUMNS, [{"name": "a"}, {"z_m": 2.0}])
    assert [row["name"] for row in filled] == ["a", ""]
    assert math.isnan(filled.rows[0]["z_m"])
    assert filled.rows[1]["z_m"] == 2.0


@pytest.mark.parametrize("row", [{"name": "a"}, {"name": "a", "z_m": 1, "more": 2}])
def test_missing_and_unknown_columns_raise(row):
    with pytest.raises(InputError, match=r"row 0 .*(z_m|more)"):
        Table(COLUMNS, (row,))


def test_where_and_groups():
    rows = tuple({"name": word, "z_m": float(k)} for k, word in enumerate("abcab"))
    whole = Table(COLUMNS, rows)
    assert len(whole.where(name=("a", "b"))) == 4
    assert whole.where(lambda row: row["z_m"] > 2, name="a").numbers(
        "z_m"
    ).tolist() == [3.0]
    assert {key[0]: part.numbers("z_m").tolist() for key, part in whole.groups("name")} == {
        "a": [0.0, 3.0], "b": [1.0, 4.0], "c": [2.0],
    }  # fmt: skip
