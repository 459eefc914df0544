"""Bytes on the disk or in a bucket: read whole, written whole or not at all. Knows no format.

A file or a folder is made aside, under a dotted temporary name beside its place, flushed to the disk, and renamed: the
one step that either happens or does not (POSIX rename). What fails on the way is removed and told as OutputError. In a
bucket, where nothing can be renamed, a folder appears by its mark: see `twinlens.dataset.storage`.
"""

import contextlib
import errno
import os
import secrets
import shutil
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path, PurePosixPath

from twinlens.dataset.storage import (
    MARK,
    Place,
    RemotePath,
    Where,
    place,
    remove_objects,
    removed_on_failure,
    write_marked,
    write_objects,
)
from twinlens.errors import FileError, InputError, OutputError

_ASIDE = ".unfinished-"

_REMEDIES = {
    errno.ENOSPC: "the disk is full: free some space or write elsewhere",
    errno.EDQUOT: "the disk quota is used up: free some space or write elsewhere",
    errno.EROFS: "the file system is read-only: write elsewhere",
    errno.EACCES: "no permission: choose a folder you may write to",
    errno.EPERM: "no permission: choose a folder you may write to",
    errno.ENOTDIR: "a file stands where a folder is needed: choose another name",
    errno.EEXIST: "a file stands where a folder is needed: choose another name",
    errno.ENOTEMPTY: "something has come to stand there meanwhile: choose another name",
    errno.ENAMETOOLONG: "the name is too long: choose a shorter one",
}


def read_bytes(path: Where) -> bytes:
    """The whole file, or FileError naming it."""
    try:
        return place(path).read_bytes()
    except FileNotFoundError:
        raise FileError(f"{path}: no such file") from None
    except FileError:
        raise
    except (OSError, ValueError) as error:
        raise FileError(f"{path}: cannot be read ({_reason(error)})") from None


def write_file(path: Where, data: bytes) -> None:
    """`data` as the file `path`, replacing what was there: whole, or not at all and OutputError."""
    write_pieces(path, (data,))


def write_pieces(path: Where, pieces: Iterable[bytes]) -> None:
    """`write_file` for a file made piece by piece, so that it need not be in memory as one; in a bucket it still is."""
    path = place(path)
    if isinstance(path, RemotePath):
        path.write_bytes(b"".join(pieces))
        return
    with _told_as_output_error(path), _removed_on_failure(_aside(path)) as aside:
        path.parent.mkdir(parents=True, exist_ok=True)
        _write_and_flush(aside, pieces)
        aside.replace(path)
        _flush_folder(path.parent)


def write_folder(folder: Where, files: Mapping[str, bytes], overwrite: bool = False) -> None:
    """A folder of `files` (relative name with / -> content): whole, or not at all and OutputError.

    A folder that is there already is refused, unless `overwrite`: then it is moved aside, replaced and removed.
    """
    folder = place(folder)
    if isinstance(folder, RemotePath) and MARK in files:
        write_marked(folder, {_checked(name).as_posix(): data for name, data in files.items()}, overwrite)
    else:
        fill_folder(folder, files.items(), overwrite)


def fill_folder(folder: Where, files: Iterable[tuple[str, bytes]], overwrite: bool = False) -> list[str]:
    """`write_folder` for files made one after the other, so that one at a time is in memory; their names.

    In a bucket an error removes what was written; a killed process leaves it.
    """
    folder = place(folder)
    if isinstance(folder, RemotePath):
        return _fill_remote(folder, files, overwrite)
    if not overwrite and os.path.lexists(folder):
        raise OutputError(f"{folder}: is there already; choose another name, or overwrite it (--overwrite)")
    with _told_as_output_error(folder), _removed_on_failure(_aside(folder)) as aside:
        names = _fill(aside, files)
        if overwrite and os.path.lexists(folder):
            _swap(aside, folder)
        else:
            aside.rename(folder)
        _flush_folder(folder.parent)
    return names


def remove_unfinished(folder: Where) -> list[str]:
    """Remove what a killed process left half-written in `folder`; the names. Nobody else may be writing there.

    In a bucket there is nothing to remove: a sample without its mark is written over.
    """
    folder = place(folder)
    if isinstance(folder, RemotePath):
        return []
    left = sorted(entry for entry in folder.glob(f".*{_ASIDE}*") if _ASIDE in entry.name)
    for entry in left:
        _remove(entry)
    return [entry.name for entry in left]


def files_below(folder: Place) -> list[str]:
    """The relative names, with /, of all files below `folder`, sorted."""
    if isinstance(folder, RemotePath):
        return folder.files()
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())


def is_hidden(name: str) -> bool:
    """Whether an entry is none of a dataset's: dotted names, the half-written ones among them."""
    return name.startswith(".")


def _fill_remote(folder: RemotePath, files: Iterable[tuple[str, bytes]], overwrite: bool) -> list[str]:
    there = set(folder.files())
    if there and not overwrite:
        raise OutputError(f"{folder}: is there already; choose another name, or overwrite it (--overwrite)")
    names: list[str] = []
    with removed_on_failure(folder, names):
        for name, data in files:
            if name in names:
                raise _same_name(name)
            names.append(_checked(name).as_posix())
            write_objects(folder, {names[-1]: data})
    remove_objects(folder, sorted(there - set(names)))
    return names


def _fill(aside: Path, files: Iterable[tuple[str, bytes]]) -> list[str]:
    aside.mkdir(parents=True)
    inside, names = {aside}, []
    for name, data in files:
        target = aside / _checked(name)
        if target.exists():
            raise _same_name(name)
        target.parent.mkdir(parents=True, exist_ok=True)
        inside.add(target.parent)
        _write_and_flush(target, (data,))
        names.append(name)
    for each in inside:
        _flush_folder(each)
    return names


def _same_name(name: str) -> InputError:
    return InputError(f"two files would be named {name}; give the samples names that stay apart")


def _checked(name: str) -> PurePosixPath:
    relative = PurePosixPath(name)
    if relative.is_absolute() or ".." in relative.parts or not relative.parts:
        raise InputError(f"a file of a sample needs a plain relative name, got {name!r}")
    return relative


def _swap(aside: Path, folder: Path) -> None:
    old = _aside(folder)
    folder.rename(old)
    try:
        aside.rename(folder)
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
    # A rename is on the disk only once its folder is; some file systems refuse to flush a folder, and have no need to.
    with contextlib.suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def _aside(path: Path) -> Path:
    return path.with_name(f".{path.name[:40]}{_ASIDE}{os.getpid()}-{secrets.token_hex(4)}")


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with contextlib.suppress(OSError):
            path.unlink(missing_ok=True)


@contextlib.contextmanager
def _removed_on_failure(aside: Path) -> Iterator[Path]:
    try:
        yield aside
    except BaseException:  # an interrupt must leave nothing half-written either
        _remove(aside)
        raise


@contextlib.contextmanager
def _told_as_output_error(path: Path) -> Iterator[None]:
    try:
        yield
    except OutputError:
        raise
    except OSError as error:
        raise OutputError(f"{path}: cannot be written; {_remedy(error)}") from error
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        raise OutputError(f"{path}: cannot be written; {error}") from error


def _remedy(error: OSError) -> str:
    return _REMEDIES.get(error.errno or 0, f"{_reason(error)}: check the path")


def _reason(error: Exception) -> str:
    return (isinstance(error, OSError) and error.strerror) or str(error)
