"""Exclusive and shared locks of a folder; no lock file is left."""

import os
import signal
import subprocess
import sys
import threading
import warnings

import pytest

from twinlens.dataset.files import (
    _locked_folder,
    locked,
    remove_abandoned,
    remove_unfinished,
    write_file,
)
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
    (tmp_path / ".c.unfinished-1-00").mkdir()
    an_hour_ago = (tmp_path / "folder").stat().st_mtime - 3600
    os.utime(tmp_path / ".c.unfinished-1-00", (an_hour_ago, an_hour_ago))
    remove_abandoned(tmp_path)
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == [".a.unfinished-1-00", ".hidden", "folder"]


@pytest.mark.parametrize("mark", ["unfinished", "replaced"])
def test_a_new_empty_folder_is_left_alone_for_its_process_may_not_have_locked_it_yet(
    tmp_path, mark
):
    (tmp_path / f".a.{mark}-1-00").mkdir()
    remove_abandoned(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [f".a.{mark}-1-00"]


KILLED_AT_A_RENAME = """
import os, pathlib, signal, sys
from twinlens.dataset.files import write_folder

rename, left = pathlib.Path.rename, [int(sys.argv[2])]

def killed(path, target):
    if left[0] == 0:
        os.kill(os.getpid(), signal.SIGKILL)
    left[0] -= 1
    return rename(path, target)

pathlib.Path.rename = killed
write_folder(sys.argv[1], {"a.txt": b"new"}, overwrite=True)
"""


@pytest.mark.parametrize("clear", [remove_abandoned, remove_unfinished])
@pytest.mark.parametrize(
    ("renames", "content", "message"),
    [(0, b"old", None), (1, b"old", "set: restored"), (2, b"new", "holds an earlier")],
)
def test_a_process_killed_while_it_replaces_a_folder_loses_none(
    tmp_path, renames, content, message, clear
):
    folder = tmp_path / ("set" + 200 * "x")  # a long name is put back whole
    folder.mkdir()
    (folder / "a.txt").write_bytes(b"old")
    command = [sys.executable, "-c", KILLED_AT_A_RENAME, folder, str(renames)]
    assert subprocess.run(command, check=False).returncode == -signal.SIGKILL
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        clear(tmp_path)
    assert (folder / "a.txt").read_bytes() == content
    messages = [str(warning.message) for warning in caught]
    assert len(messages) == (message is not None)
    assert message is None or message.replace("set:", f"{folder.name}:") in messages[0]
    kept = [path for path in tmp_path.rglob("a.txt") if path.read_bytes() == b"old"]
    assert len(kept) == 1
    assert not list(tmp_path.glob(".*.unfinished-*"))


def test_what_a_living_process_has_moved_aside_is_not_touched(tmp_path):
    aside = tmp_path / ".set.replaced-1-00"
    (aside / "set").mkdir(parents=True)
    with _locked_folder(aside):
        remove_abandoned(tmp_path)
        assert [path.name for path in tmp_path.iterdir()] == [aside.name]
    with pytest.warns(UserWarning, match="set: restored"):
        remove_abandoned(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["set"]
