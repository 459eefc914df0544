"""benchmarks/validity.py, with the published boards in place of real pairs."""

import importlib.util
import math
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture(scope="module")
def validity():
    path = list(sys.path)
    spec = importlib.util.spec_from_file_location("validity", FOLDER / "validity.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["validity"] = module
    spec.loader.exec_module(module)
    yield module
    sys.path[:] = path
    for name in ("validity", "run", "tables"):
        sys.modules.pop(name, None)


def published(method):
    """The row of a method in the table of frozen/README.md: bundled and families, through pinhole and lens."""
    lines = (FOLDER / "frozen" / "README.md").read_text().splitlines()
    (row,) = (line for line in lines if line.startswith(f"| `{method}` |") and "(" not in line)  # fmt: skip
    return [float(cell.strip(" *")) for cell in row.split("|")[2:6]]


def test_rankings_and_levels_are_those_of_the_published_tables(validity):
    boards = validity.frozen_boards()
    found = validity.compare("bundled", boards["bundled"], boards["families"])
    page = (FOLDER / "frozen" / "README.md").read_text()
    assert f"| bundled, families | {found.tau[0]:.2f} (" in page
    for method in ("sgm", "zncc:block_size=7", "opencv_bm"):
        pinhole, lens, on_pinhole, on_lens = published(method)
        expected = math.log2((pinhole + lens) / (on_pinhole + on_lens))
        assert found.levels[method] == pytest.approx(expected, abs=0.03)


def test_a_board_is_as_hard_as_itself(validity):
    board = validity.frozen_boards()["families, lens"]
    found = validity.compare("same", board, board)
    assert found.tau[0] == 1
    assert set(found.levels.values()) == {0.0}
    page = validity.page_of(board, [found], "1.00", {})
    assert "25 real pairs" in page
    assert "nan" not in page
