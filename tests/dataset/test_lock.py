"""One run at a time in a folder; what is left behind when it ends is nothing."""

import threading

import pytest

from twinlens.dataset.lock import locked
from twinlens.errors import OutputError


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "set"


def test_one_alone_or_several_that_share(folder):
    with locked(folder):
        for shared in (False, True):
            with pytest.raises(OutputError, match=r"set: another run is writing there; go away$"):
                locked(folder, shared, remedy="go away").__enter__()
    refused = pytest.raises(OutputError, match=r"another run is writing there; wait for it$")
    with locked(folder, shared=True), locked(folder, shared=True), refused:
        locked(folder).__enter__()
    with locked(folder):
        pass


def test_nothing_is_left_of_a_lock(folder):
    with pytest.raises(KeyError), locked(folder):
        raise KeyError
    assert list(folder.iterdir()) == []


def test_who_waited_for_a_lock_that_was_removed_takes_the_new_one(folder):
    """Else two would write: one with the file that is gone, one with the file that is there."""
    entered, leave, second = threading.Event(), threading.Event(), threading.Event()

    def wait_for_it():
        entered.set()
        with locked(folder, wait=True):
            second.set()
            leave.wait(10)

    with locked(folder):
        waiter = threading.Thread(target=wait_for_it)
        waiter.start()
        assert entered.wait(10)
        assert not second.wait(0.2)
    assert second.wait(10)
    with pytest.raises(OutputError, match="another run is writing"), locked(folder):
        pass
    leave.set()
    waiter.join()
    assert not (folder / ".lock").exists()
