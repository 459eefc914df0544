"""What became of samples, packed."""

import tracemalloc

import pytest

from twinlens.dataset import Row
from twinlens.factory.ledger import Entries, Failure


def row(index):
    """A row as samples have it."""
    files = {f"file{k}.pfm": f"{index * 1000003 + k:064x}" for k in range(12)}
    turned = [{"attempt": 0, "reason": "dark", "found": "mean level 0.01"}] * (index % 2)
    return Row(f"{index:07d}", files, {"index": index, "split": None, "far": "inf", "z": 0.1, "rejections": turned})


def failure(index):
    """A sample that could not be made."""
    return Failure(index, [{"attempt": 0, "reason": "burnt", "found": "all of it"}] * 2, "the light")


def test_what_is_put_in_comes_out_in_the_order_of_the_samples():
    entries = Entries()
    for index in (7, 3, 5, 0):
        entries[index] = failure(index) if index == 5 else row(index)
    assert list(entries) == [0, 3, 5, 7]
    assert len(entries) == 4
    assert (3 in entries, 4 in entries) == (True, False)
    assert entries.made == [0, 3, 7]
    assert list(entries.rows) == [row(0), row(3), row(7)]
    assert list(entries.rows[1:]) == [row(3), row(7)]
    assert entries.failures == [failure(5)]
    assert entries[5] == failure(5)
    assert entries[7] == row(7)
    assert entries.rejections() == {"burnt": 2, "dark": 2}


def test_a_sample_that_failed_may_be_made_after_all_and_be_lost():
    entries = Entries()
    entries[1] = failure(1)
    entries[1] = row(1)
    assert (entries.made, entries.failures) == ([1], [])
    entries.pop(1)
    entries.pop(2)
    assert not len(entries)
    with pytest.raises(KeyError):
        entries[1]


def test_rows_that_were_handed_out_stay_as_they_were():
    entries = Entries()
    entries[0] = row(0)
    rows = entries.rows
    entries[1] = row(1)
    assert list(rows) == [row(0)]


def test_a_row_is_remembered_in_little_more_than_its_checksums():
    entries = Entries()
    entries[0] = row(0)
    tracemalloc.start()
    try:
        before, _ = tracemalloc.get_traced_memory()
        for index in range(1, 501):
            entries[index] = row(index)
        used = tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()
    assert used / 500 < 12 * 64
