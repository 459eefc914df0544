"""Only one run at a time may write a board."""

import threading

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


def test_a_nested_run_of_the_same_board_is_refused(tmp_path):
    """By another spelling of its path, in the same thread and in another one."""
    board, alias = tmp_path / "board.json", tmp_path / "x" / ".." / "board.json"
    refused = []

    def again():
        with pytest.raises(OutputError, match="another run"):
            run_benchmark([pair()], [Flat()], save=alias, warm_up=False)
        refused.append(True)

    def progress(step):
        alias.parent.parent.mkdir()
        again()
        thread = threading.Thread(target=again)
        thread.start()
        thread.join()

    run_benchmark([pair()], [Flat()], save=board, warm_up=False, progress=progress)
    assert len(refused) == 2


def test_boards_of_other_names_may_be_written_at_once(tmp_path):
    with locked(tmp_path), locked(tmp_path, file="a.json"):
        run_benchmark([pair()], [Flat()], save=tmp_path / "b.json", warm_up=False)
    assert len(read_board(tmp_path / "b.json").entries) == 1


def test_folders_left_empty_are_removed(tmp_path):
    with pytest.raises(InputError):
        run_benchmark([pair(), pair()], [], save=tmp_path / "a" / "b" / "board.json")
    with pytest.raises(ZeroDivisionError), locked(tmp_path / "c" / "d"):
        raise ZeroDivisionError
    assert not list(tmp_path.iterdir())
