"""Only one run at a time may write a board."""

import pytest

from tests.scoring.scoring_methods import pair
from twinlens.dataset.files import locked
from twinlens.errors import InputError, OutputError
from twinlens.scoring import read_board, run_benchmark


class Flat:
    name = "flat"

    def match(self, left, right, *, num_disparities, min_disparity):
        return pair().disp0


def test_a_second_run_of_one_board_is_refused_and_changes_nothing(tmp_path):
    """Otherwise the run that ends last would overwrite the other's entries."""
    board = tmp_path / "board.json"
    with (
        locked(tmp_path, file="board.json"),
        pytest.raises(OutputError, match=r"board\.json: another run"),
    ):
        run_benchmark([pair()], [Flat()], save=board, warm_up=False)
    assert not board.exists()
    run_benchmark([pair()], [Flat()], save=board, warm_up=False)
    assert len(read_board(board).entries) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["board.json"]


def test_folders_left_empty_are_removed(tmp_path):
    with pytest.raises(InputError):
        run_benchmark([pair(), pair()], [], save=tmp_path / "a" / "b" / "board.json")
    with pytest.raises(ZeroDivisionError), locked(tmp_path / "c" / "d"):
        raise ZeroDivisionError
    assert not list(tmp_path.iterdir())
