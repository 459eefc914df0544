"""Exclusive and shared locks of a folder; no lock file is left."""

import threading

import pytest

from twinlens.dataset.files import locked
from twinlens.errors import OutputError


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "set"


def test_exclusive_and_shared_locks(folder):
    with locked(folder):
        for shared in (False, True):
            with pytest.raises(
                OutputError, match=r"set: another run is writing there; go away$"
            ):
                locked(folder, shared, remedy="go away").__enter__()
    rejected = pytest.raises(
        OutputError, match=r"another run is writing there; wait for it$"
    )
    with locked(folder, shared=True), locked(folder, shared=True), rejected:
        locked(folder).__enter__()
    with locked(folder):
        pass


def test_the_lock_file_is_removed(folder):
    folder.mkdir()
    with pytest.raises(KeyError), locked(folder):
        raise KeyError
    assert list(folder.iterdir()) == []


def test_a_waiting_process_locks_the_new_file_when_the_old_one_is_removed(folder):
    """Otherwise two would hold the lock: one of the removed file, one of the new one."""
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
