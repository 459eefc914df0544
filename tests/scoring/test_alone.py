"""One run at a time writes boards in a folder, whoever started it."""

import threading

import pytest
from scoring_methods import pair

from twinlens.dataset.lock import locked
from twinlens.errors import InputError, OutputError
from twinlens.scoring import read_board, run_benchmark
from twinlens.scoring.alone import alone


class Flat:
    name = "flat"

    def __call__(self, left, right, *, ndisp):
        return pair().disp0


def test_a_second_run_is_refused_and_changes_nothing(tmp_path):
    """Else whichever ends last would write its own entries alone; so also for the command line's, whose lock it is."""
    board = tmp_path / "board.json"
    with locked(tmp_path), pytest.raises(OutputError, match="another run is writing there"):
        run_benchmark([pair()], [Flat()], save=board, warm_up=False)
    assert not board.exists()
    run_benchmark([pair()], [Flat()], save=board, warm_up=False)
    assert len(read_board(board).entries) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["board.json"]


def test_while_a_run_goes_on_others_are_refused_and_it_goes_in_again_itself(tmp_path):
    heard = []

    def other():
        with pytest.raises(OutputError), alone(tmp_path):
            pass
        heard.append("refused")

    def told(step):
        thread = threading.Thread(target=other)
        thread.start()
        thread.join()
        with alone(tmp_path):
            heard.append("in")

    run_benchmark([pair()], [Flat()], save=tmp_path / "board.json", warm_up=False, progress=told)
    assert heard == ["refused", "in"]
    with locked(tmp_path):
        pass


def test_folders_made_for_nothing_are_removed(tmp_path):
    with pytest.raises(InputError):
        run_benchmark([pair(), pair()], [], save=tmp_path / "a" / "b" / "board.json")
    with pytest.raises(ZeroDivisionError), alone(tmp_path / "c" / "d"):
        raise ZeroDivisionError
    assert not list(tmp_path.iterdir())
