"""Files and folders written atomically, on disk or in a bucket.

Local files and folders are made under a hidden temporary name in the same folder, flushed to the disk, and renamed
(POSIX rename is atomic). Failures remove the temporary files and raise OutputError. For buckets, which cannot rename,
see `twinlens.dataset.storage`.
"""

import contextlib
import errno
import os
import secrets
import shutil
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path, PurePosixPath

from twinlens.dataset.storage import (
    EXISTS,
    MARK,
    Place,
    RemotePath,
    Where,
    discard_objects,
    place,
    remove_objects,
    write_marked,
    write_objects,
)
from twinlens.errors import FileError, InputError, OutputError

_TEMPORARY = ".unfinished-"

_REMEDIES = {
    errno.ENOSPC: "the disk is full: free some space or write elsewhere",
    errno.EDQUOT: "the disk quota is used up: free some space or write elsewhere",
    errno.EROFS: "the file system is read-only: write elsewhere",
    errno.EACCES: "no permission: choose a folder that you may write to",
    errno.EPERM: "no permission: choose a folder that you may write to",
    errno.ENOTDIR: "a file exists where a folder is needed: choose another name",
    errno.EEXIST: "a file exists where a folder is needed: choose another name",
    errno.ENOTEMPTY: "another process has written there: choose another name",
    errno.ENAMETOOLONG: "the name is too long: choose a shorter one",
}


def read_bytes(path: Where) -> bytes:
    """The content of a file. Raises FileError that names it."""
    try:
        return place(path).read_bytes()
    except FileNotFoundError:
        raise FileError(f"{path}: no such file") from None
    except FileError:
        raise
    except (OSError, ValueError) as error:
        raise FileError(f"{path}: cannot be read ({_reason(error)})") from None


def write_file(path: Where, data: bytes) -> None:
    """Write `data` as the file `path`, atomically; an existing file is replaced. Raises OutputError."""
    write_pieces(path, (data,))


def write_pieces(path: Where, pieces: Iterable[bytes]) -> None:
    """`write_file` with one piece in memory at a time; a remote file is in memory as a whole."""
    path = place(path)
    if isinstance(path, RemotePath):
        path.write_bytes(b"".join(pieces))
        return
    with _temporary(path) as temporary:
        path.parent.mkdir(parents=True, exist_ok=True)
        _write_and_flush(temporary, pieces)
        temporary.replace(path)
        _flush_folder(path.parent)


def write_folder(folder: Where, files: Mapping[str, bytes], overwrite: bool = False) -> None:
    """Write a folder of `files` (relative name with / -> content), atomically. Raises OutputError.

    An existing folder is rejected unless `overwrite` is set; then it is moved aside, replaced and removed.
    """
    folder = place(folder)
    if isinstance(folder, RemotePath) and MARK in files:
        write_marked(folder, {check_relative(name): data for name, data in files.items()}, overwrite)
    else:
        fill_folder(folder, files.items(), overwrite)


def fill_folder(folder: Where, files: Iterable[tuple[str, bytes]], overwrite: bool = False) -> list[str]:
    """`write_folder` with one file in memory at a time; returns the names.

    A remote folder is not atomic: an error removes what was written, a killed process leaves it.
    """
    folder = place(folder)
    if isinstance(folder, RemotePath):
        return _fill_remote(folder, files, overwrite)
    if not overwrite and os.path.lexists(folder):
        raise OutputError(f"{folder}: {EXISTS}")
    with _temporary(folder) as temporary:
        names = _fill(temporary, files)
        if overwrite and os.path.lexists(folder):
            _swap(temporary, folder)
        else:
            temporary.rename(folder)
        _flush_folder(folder.parent)
    return names


def remove_unfinished(folder: Where) -> list[str]:
    """Remove the temporary files of killed processes from a local `folder`; their names. No process may be writing."""
    folder = place(folder)
    if isinstance(folder, RemotePath):
        return []
    found = sorted(entry for entry in folder.glob(f".*{_TEMPORARY}*") if _TEMPORARY in entry.name)
    for entry in found:
        _remove(entry)
    return [entry.name for entry in found]


def files_below(folder: Place) -> list[str]:
    """Relative names, with /, of all files below `folder`, sorted."""
    if isinstance(folder, RemotePath):
        return folder.files()
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())


def is_hidden(name: str) -> bool:
    """Whether an entry is not part of a dataset: hidden files, including temporary ones."""
    return name.startswith(".")


def check_relative(name: str) -> str:
    """`name` if it is a relative path with / that stays below its folder. Raises InputError."""
    parts = name.split("/")
    if any(part in ("", ".", "..") or "\\" in part or "\0" in part for part in parts) or Path(name).is_absolute():
        raise InputError(f"{name!r} is not a plain relative name")
    return PurePosixPath(name).as_posix()


def _fill_remote(folder: RemotePath, files: Iterable[tuple[str, bytes]], overwrite: bool) -> list[str]:
    existing = set(folder.files())
    if existing and not overwrite:
        raise OutputError(f"{folder}: {EXISTS}")
    names: dict[str, None] = {}
    with contextlib.ExitStack() as cleanup:
        cleanup.callback(discard_objects, folder, names)
        for name, data in files:
            _check_new(name, names)
            names[name] = None
            write_objects(folder, {name: data})
        cleanup.pop_all()
    remove_objects(folder, sorted(existing - set(names)))
    return list(names)


def _fill(folder: Path, files: Iterable[tuple[str, bytes]]) -> list[str]:
    folder.mkdir(parents=True)
    names: dict[str, None] = {}
    for name, data in files:
        _check_new(name, names)
        names[name] = None
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        _write_and_flush(folder / name, (data,))
    for each in {folder, *((folder / name).parent for name in names)}:
        _flush_folder(each)
    return list(names)


def _check_new(name: str, names: Mapping[str, None]) -> None:
    if check_relative(name) in names:
        raise InputError(f"two files would be named {name}; rename one of the samples")


def _swap(temporary: Path, folder: Path) -> None:
    old = _temporary_name(folder)
    folder.rename(old)
    try:
        temporary.rename(folder)
    except BaseException:
        old.rename(folder)
        raise
    _remove(old)


def _write_and_flush(path: Path, pieces: Iterable[bytes]) -> None:
    with path.open("wb") as file:
        file.writelines(pieces)
        file.flush()
        os.fsync(file.fileno())


def _flush_folder(folder: Path) -> None:
    # A rename is durable only once its folder is flushed; some file systems refuse, and do not need it.
    with contextlib.suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def _temporary_name(path: Path) -> Path:
    return path.with_name(f".{path.name[:40]}{_TEMPORARY}{os.getpid()}-{secrets.token_hex(4)}")


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with contextlib.suppress(OSError):
            path.unlink(missing_ok=True)


@contextlib.contextmanager
def _temporary(path: Path) -> Iterator[Path]:
    """A temporary name in the folder of `path`, removed on any exception; errors as OutputError."""
    try:
        temporary = _temporary_name(path)
        try:
            yield temporary
        except BaseException:
            _remove(temporary)
            raise
    except (OutputError, InputError):
        raise
    except OSError as error:
        remedy = _REMEDIES.get(error.errno or 0, f"{_reason(error)}: check the path")
        raise OutputError(f"{path}: cannot be written; {remedy}") from error
    except ValueError as error:
        raise OutputError(f"{path}: cannot be written; {error}") from error


def _reason(error: Exception) -> str:
    return (isinstance(error, OSError) and error.strerror) or str(error)
