"""Exclusive and shared locks of a folder; no lock file is left."""

import signal
import subprocess
import sys
import threading

import pytest

from twinlens.dataset.files import locked, remove_abandoned, write_file
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


WRITER = """
import sys
from twinlens.dataset.files import write_folder

def files():
    yield "a.txt", b"one"
    print("writing", flush=True)
    sys.stdin.read()

write_folder(sys.argv[1], files())
"""


def test_what_a_killed_process_was_writing_is_removed_and_what_a_living_one_writes_is_kept(
    tmp_path,
):
    def begin(name):
        command = [sys.executable, "-c", WRITER, tmp_path / name]
        writer = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        assert writer.stdout.readline() == b"writing\n"
        return writer

    with begin("killed") as killed, begin("living") as living:
        killed.send_signal(signal.SIGKILL)
        killed.wait()
        assert len(list(tmp_path.iterdir())) == 2
        remove_abandoned(tmp_path)
        (left,) = tmp_path.iterdir()
        assert left.name.startswith(".living.unfinished-")
        living.stdin.close()
        assert living.wait() == 0
    assert [path.name for path in tmp_path.iterdir()] == ["living"]


def test_only_unfinished_folders_are_removed(tmp_path):
    for name in (".hidden", "folder"):
        (tmp_path / name).mkdir()
    write_file(tmp_path / ".a.unfinished-1-00", b"a file may still be written")
    (tmp_path / ".b.unfinished-1-00" / "deep").mkdir(parents=True)
    remove_abandoned(tmp_path)
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == [".a.unfinished-1-00", ".hidden", "folder"]
