import errno
import os
from pathlib import Path

import pytest

from twinlens.dataset import files
from twinlens.dataset.files import (
    read_bytes,
    remove_unfinished,
    write_file,
    write_folder,
)
from twinlens.errors import FileError, InputError, OutputError

CONTENT = {"a.txt": b"one", "deep/er/b.txt": b"two"}


def tree(folder):
    return {
        p.relative_to(folder).as_posix(): p.read_bytes()
        for p in folder.rglob("*")
        if p.is_file()
    }


def names(folder):
    return sorted(entry.name for entry in folder.iterdir())


def fail_after(monkeypatch, count, error):
    """Let `count` files be written, then raise."""
    written = []
    whole = files._write_and_flush

    def write(path, data):
        if len(written) == count:
            path.write_bytes(data[: len(data) // 2])
            raise error
        written.append(path)
        whole(path, data)

    monkeypatch.setattr(files, "_write_and_flush", write)


@pytest.mark.parametrize("count", [0, 1])
@pytest.mark.parametrize(
    ("error", "raised", "remedy"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), OutputError, "disk is full"),
        (OSError(errno.EIO, "Input/output error"), OutputError, "Input/output error"),
        (KeyboardInterrupt(), KeyboardInterrupt, ".*"),
    ],
)
def test_a_failure_leaves_nothing_and_keeps_existing_files(
    tmp_path, monkeypatch, count, error, raised, remedy
):
    write_folder(tmp_path / "old", {"x": b"kept"})
    fail_after(monkeypatch, count, error)
    for name, overwrite in (("new", False), ("old", True)):
        with pytest.raises(raised, match=remedy) as caught:
            write_folder(tmp_path / name, CONTENT, overwrite)
        if raised is OutputError:
            assert str(caught.value).startswith(
                f"{tmp_path / name}: cannot be written; "
            )
            assert "\n" not in str(caught.value)
    assert tree(tmp_path) == {"old/x": b"kept"}
    assert names(tmp_path) == ["old"]


def test_a_failed_swap_restores_the_old_folder(tmp_path, monkeypatch):
    write_folder(tmp_path / "s", {"x": b"old"})
    rename = type(tmp_path).rename

    def broken(self, target):
        if (
            files._TEMPORARY in self.name
            and target == tmp_path / "s"
            and (self / "a.txt").exists()
        ):
            raise OSError(errno.EIO, "Input/output error")
        return rename(self, target)

    monkeypatch.setattr(type(tmp_path), "rename", broken)
    with pytest.raises(OutputError):
        write_folder(tmp_path / "s", CONTENT, overwrite=True)
    assert tree(tmp_path) == {"s/x": b"old"}


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_errors_on_flush_are_noticed(tmp_path):
    with pytest.raises(OSError, match="No space"):
        files._write_and_flush(Path("/dev/full"), b"x" * 10)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_without_permission(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(OutputError, match="no permission"):
        write_folder(tmp_path / "s", CONTENT)
    with pytest.raises(OutputError, match="no permission"):
        write_file(tmp_path / "f", b"")


@pytest.mark.parametrize("name", ["../evil", "/etc/evil", "a/../../evil", ""])
def test_names_stay_below_the_folder(tmp_path, name):
    with pytest.raises(InputError, match="plain relative name"):
        write_folder(tmp_path / "s", {name: b""})
    assert names(tmp_path) == []


@pytest.mark.parametrize("name", ["x" * 300, "nul\0byte"])
def test_names_that_no_file_system_accepts(tmp_path, name):
    with pytest.raises(OutputError, match="cannot be written"):
        write_file(tmp_path / name, b"")
    with pytest.raises(FileError):
        read_bytes(tmp_path / name)


def test_a_file_is_replaced_atomically(tmp_path, monkeypatch):
    write_file(tmp_path / "f", b"old")
    fail_after(monkeypatch, 0, OSError(errno.ENOSPC, "No space left on device"))
    with pytest.raises(OutputError, match="disk is full"):
        write_file(tmp_path / "f", b"newer")
    assert tree(tmp_path) == {"f": b"old"}


def test_files_of_killed_processes_are_removed(tmp_path):
    write_folder(tmp_path / "whole", CONTENT)
    (tmp_path / f".s{files._TEMPORARY}12-ab").mkdir()
    (tmp_path / f".s{files._TEMPORARY}12-ab" / "x").touch()
    (tmp_path / f".d{files._TEMPORARY}13-cd").touch()
    (tmp_path / ".gitignore").touch()
    assert len(remove_unfinished(tmp_path)) == 2
    assert names(tmp_path) == [".gitignore", "whole"]
