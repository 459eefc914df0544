"""The published page of the frozen benchmark follows from its boards, and its recipes can be read."""

import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest

from twinlens.scoring import STATISTICS, read_board

FOLDER = Path(__file__).parents[2] / "benchmarks" / "frozen"
BOARDS = {
    name: read_board(FOLDER / f"{name}.json")
    for name in ("bundled", "families", "motorcycle")
}


@pytest.fixture
def scripts(monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))
    import run
    import tables

    yield run, tables
    for name in ("run", "tables"):
        sys.modules.pop(name)


def bad(board, method):
    """Mean of totbad2.0 over the non-occluded pixels of all samples, computed independently."""
    values = [
        BOARDS[board].find(method, s, "middlebury-v3").value("nonocc", "totbad2.0")
        for s in BOARDS[board].samples
    ]
    return sum(values) / len(values)


def test_the_page_follows_from_the_boards(scripts):
    run, tables = scripts
    page = (FOLDER / "README.md").read_text()
    assert page == tables.page()
    assert f"# twinlens frozen benchmark {run.VERSION}\n" in page
    for board in BOARDS.values():
        assert set(board.methods) == set(run.METHODS)
        assert all(entry.ok for entry in board.entries)
    for method in run.METHODS:
        (row,) = [
            line for line in page.splitlines() if line.startswith(f"| `{method}` |")
        ]
        assert f"{bad('motorcycle', method):.1f}" in row


@pytest.mark.parametrize("board", ["bundled", "families", "motorcycle"])
def test_costs_that_compare_brightness_are_worse_than_invariant_ones(board):
    """Two real cameras differ in brightness, and so do the two cameras of the benchmark."""
    for size in (7, 15):
        assert bad(board, f"census:block_size={size}") < bad(
            board, f"sad:block_size={size}"
        )
        assert bad(board, f"zsad:block_size={size}") < bad(
            board, f"sad:block_size={size}"
        )
        assert bad(board, f"zssd:block_size={size}") < bad(
            board, f"ssd:block_size={size}"
        )


@pytest.mark.parametrize(
    "name",
    [
        name
        for name, statistic in STATISTICS.items()
        # Half of the scenes have no sky, and the truth of no scene has holes, as that of scanners has.
        if math.isfinite(statistic.real[1]) and name != "unknown"
    ],
)
def test_image_statistics_are_near_those_of_real_pairs(name):
    """The median is in the 10 % to 90 % range of the real pairs, and within a third of it from their median."""
    measured = json.loads((FOLDER / "results.json").read_text())["statistics"]
    median = np.nanmedian(
        [row[name] for board in measured.values() for row in board.values()]
    )
    middle, low, high = STATISTICS[name].real
    assert low <= median <= high
    assert abs(median - middle) <= (high - low) / 3
