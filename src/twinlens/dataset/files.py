"""Files and folders written atomically, on disk or in a bucket.

Local files and folders are made under a hidden temporary name in the same folder, flushed to the disk, and renamed
(POSIX rename is atomic). Failures remove the temporary files and raise OutputError. For buckets, which cannot rename,
see `twinlens.dataset.storage`.
"""

import contextlib
import errno
import hashlib
import os
import secrets
import shutil
import time
import warnings
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from twinlens.dataset.storage import (
    EXISTS,
    Place,
    RemotePath,
    Where,
    fill_remote,
    place,
)
from twinlens.errors import FileError, InputError, OutputError

A_FILE = "is a file where a folder is needed; choose another name"
_TEMPORARY = ".unfinished-"
_REPLACED = ".replaced-"
"""In the name of a folder that holds the earlier content of a folder, until the new one is in its place."""
_NEW_S = 60  # an empty folder of this age may not have been locked yet

_FULL = "the disk is full: free some space or write elsewhere"
_NO_PERMISSION = "no permission: choose a folder that you may write to"
_REMEDIES = {
    errno.ENOSPC: _FULL,
    errno.EDQUOT: _FULL,
    errno.EACCES: _NO_PERMISSION,
    errno.EPERM: _NO_PERMISSION,
    errno.EROFS: "the file system is read-only: write elsewhere",
    errno.ENOTEMPTY: "another process has written there: choose another name",
    errno.ENAMETOOLONG: "the name is too long: choose a shorter one",
    errno.EXDEV: "hard links cannot lead to another file system: copy the files instead",
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
        raise FileError(
            f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})"
        ) from None


def read_text(path: Where) -> str:
    """The content of a UTF-8 file. Raises FileError that names it."""
    try:
        return read_bytes(path).decode("utf-8")
    except UnicodeDecodeError:
        raise FileError(f"{path}: not a text file") from None


def write_file(path: Where, data: bytes, flush: bool = True) -> None:
    """Write `data` as the file `path`, atomically; an existing file is replaced. Raises OutputError.

    flush : whether it is flushed to the disk, without which it may be empty after a power failure.
    """
    path = place(path)
    if isinstance(path, RemotePath):
        path.write_bytes(data)
        return
    with _temporary(path) as temporary:
        path.parent.mkdir(parents=True, exist_ok=True)
        _write(temporary, data, flush)
        temporary.replace(path)
        if flush:
            _flush_folder(path.parent)


def write_folder(
    folder: Where,
    files: Mapping[str, bytes] | Iterable[tuple[str, bytes]],
    overwrite: bool = False,
    links: Mapping[str, Path] | None = None,
    flush: bool = True,
) -> None:
    """Write a folder of `files` (relative name with / and content), atomically. Raises OutputError.

    links : relative name -> local file, of which the new folder gets a hard link.
    flush : whether every file is flushed to the disk, without which a power failure may leave some of them empty.

    One file of an iterable is in memory at a time. An existing folder is rejected unless `overwrite` is set. A remote
    folder is atomic only if it is a sample: otherwise an error removes what was written, a killed process leaves it.
    """
    folder = place(folder)
    checked = _checked(files.items() if isinstance(files, Mapping) else files)
    if isinstance(folder, RemotePath):
        fill_remote(
            folder, dict(checked) if isinstance(files, Mapping) else checked, overwrite
        )
        return
    if not overwrite and os.path.lexists(folder):
        raise OutputError(f"{folder}: {EXISTS}")
    with _temporary(folder) as temporary:
        temporary.mkdir(parents=True)
        with _locked_folder(temporary):
            folders = {temporary}
            for name, data in checked:
                path = temporary / name
                path.parent.mkdir(parents=True, exist_ok=True)
                _write(path, data, flush)
                folders.add(path.parent)
            for name, source in (links or {}).items():
                path = temporary / check_relative(name)
                path.parent.mkdir(parents=True, exist_ok=True)
                path.hardlink_to(source)
                folders.add(path.parent)
            for path in folders if flush else ():
                _flush_folder(path)
            _put_in_place(temporary, folder)


def _put_in_place(temporary: Path, folder: Path) -> None:
    """Rename `temporary` to `folder`; what was there is removed afterwards, or restored if the renaming fails."""
    if os.path.lexists(folder):
        _replace(temporary, folder)
    else:
        temporary.rename(folder)
    _flush_folder(folder.parent)


def _replace(temporary: Path, folder: Path) -> None:
    """Rename `temporary` to `folder`, whose earlier content is moved aside first.

    A process that is killed between the two renamings leaves the earlier content to `remove_abandoned`, which puts it
    back: only after the second one does it get the mark of what may be removed.
    """
    aside = _temporary_name(folder, _REPLACED)
    aside.mkdir()
    with _locked_folder(aside):
        try:
            folder.rename(aside / folder.name)
            temporary.rename(folder)
        except BaseException:
            _put_back(aside)
            raise
        removable = _temporary_name(folder)
        aside.rename(removable)
        _remove(removable)


def _put_back(aside: Path) -> list[Path]:
    """Move the content of a folder one level up, where its names are free, and remove the folder if it is empty then.

    Returns the new places.
    """
    places = []
    for entry in aside.iterdir():
        before = aside.parent / entry.name
        if not os.path.lexists(before):
            entry.rename(before)
            places.append(before)
    _remove_empty([aside])
    return places


def check_replaceable(folder: Place, replaceable: bool, kind: str) -> None:
    """Raise OutputError for an existing file or non-empty folder, unless `replaceable` says that it is `kind`."""
    exists = _exists(folder)
    is_empty = exists and folder.is_dir() and not any(folder.iterdir())
    if exists and not replaceable and not is_empty:
        raise OutputError(
            f"{folder}: exists and is not {kind}, so it is not overwritten; choose another name"
        )


def _exists(place: Place) -> bool:
    """Whether something is there, also a broken link."""
    if isinstance(place, RemotePath):
        return place.exists()
    return os.path.lexists(place)


def existing_part(path: Path) -> Path:
    """`path`, or else the nearest folder or file above it that exists."""
    return next(part for part in (path, *path.parents) if os.path.lexists(part))


def remove_unfinished(folder: Where) -> list[str]:
    """Remove the temporary files of killed processes from a local `folder`; their names. No process may be writing.

    Folders that these had moved aside are put back, as by `remove_abandoned`.
    """
    folder = place(folder)
    if isinstance(folder, RemotePath):
        return []
    for aside in _marked(folder, _REPLACED):
        _restore(aside)
    leftovers = _marked(folder, _TEMPORARY)
    for entry in leftovers:
        _remove(entry)
    return [entry.name for entry in leftovers]


def remove_abandoned(folder: Where) -> None:
    """Remove the unfinished folders of killed processes from a local `folder`, and put back what they had moved aside.

    Folders that are being written are locked, or are new and empty; they are left alone. Warns of each folder that is
    put back, and of each that cannot be because its name is taken.
    """
    folder = place(folder)
    if isinstance(folder, RemotePath):
        return
    for mark, clear in ((_REPLACED, _restore), (_TEMPORARY, _remove)):
        for entry in _marked(folder, mark):
            if not entry.is_dir() or _may_be_unlocked(entry):
                continue
            with contextlib.suppress(OSError), _locked_folder(entry) as is_locked:
                if is_locked:
                    clear(entry)


def _marked(folder: Path, mark: str) -> list[Path]:
    """The hidden entries of a folder with a mark in their name."""
    return sorted(folder.glob(f".*{mark}*"))


def _may_be_unlocked(folder: Path) -> bool:
    """Whether a folder is so new that its process may not have locked it yet; it writes nothing before."""
    try:
        is_new = time.time() - folder.stat().st_mtime < _NEW_S
        return is_new and not any(folder.iterdir())
    except OSError:  # the process has renamed it
        return True


def _restore(aside: Path) -> None:
    """Put back what a killed process had moved aside, and say so; what cannot be put back stays."""
    for restored in _put_back(aside):
        warnings.warn(
            f"{restored}: restored; a command that was killed had moved it aside",
            stacklevel=3,
        )
    if aside.exists():
        warnings.warn(
            f"{aside}: holds an earlier folder that a killed command had replaced; delete it or move it",
            stacklevel=3,
        )


@contextlib.contextmanager
def _locked_folder(folder: Path) -> Iterator[bool]:
    """Lock a folder while the block runs, and yield whether it could be.

    It could not if another process has locked it, nor on file systems without locks. A killed process loses its locks.
    """
    try:
        import fcntl
    except ImportError:  # Windows
        yield False
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            is_locked = True
        except OSError:
            is_locked = False
        yield is_locked
    finally:
        os.close(descriptor)


@contextlib.contextmanager
def locked(
    folder: Place,
    shared: bool = False,
    wait: bool = False,
    remedy: str = "wait for it",
    file: str = "",
) -> Iterator[None]:
    """Lock `folder`, or one `file` in it. Several processes can hold a `shared` lock, as shards do.

    The folder is created; folders that were created and are left empty are removed.
    If another run has the lock, waits for it if `wait` is set, and else raises OutputError that ends with the `remedy`.
    Buckets and file systems without locks are not locked. Why flock(2): docs/decisions/locks.md.
    """
    if isinstance(folder, RemotePath):
        yield
        return
    import fcntl  # not on Windows, where everything that needs no lock works

    lock = folder / (f".{file}.lock" if file else ".lock")
    operation = fcntl.LOCK_SH if shared else fcntl.LOCK_EX
    if not wait:
        operation |= fcntl.LOCK_NB
    created = [part for part in (folder, *folder.parents) if not part.is_dir()]
    while True:
        descriptor = _open_lock(folder, lock)
        with contextlib.ExitStack() as stack:
            stack.callback(os.close, descriptor)
            try:
                fcntl.flock(descriptor, operation)
            except BlockingIOError:
                raise OutputError(
                    f"{folder / file}: another run is writing there; {remedy}"
                ) from None
            except OSError:
                pass  # a file system without locks
            # The previous holder has removed this file: lock the new one.
            if os.fstat(descriptor).st_nlink == 0:
                continue
            stack.callback(_remove_empty, created)
            if not shared:
                stack.callback(lock.unlink, missing_ok=True)
            yield
            return


def _open_lock(folder: Path, lock: Path) -> int:
    """The descriptor of a lock file in a folder, both of which are created if needed. Raises OutputError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        return os.open(lock, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        raise _not_written(folder, error) from error


def _remove_empty(folders: Iterable[Path]) -> None:
    for folder in folders:
        with contextlib.suppress(OSError):
            folder.rmdir()


def files_below(folder: Place) -> list[str]:
    """Relative names, with /, of all files below `folder`, sorted."""
    if isinstance(folder, RemotePath):
        return folder.files()
    return sorted(
        path.relative_to(folder).as_posix()
        for path in folder.rglob("*")
        if path.is_file()
    )


def hash_files(folder: Where) -> dict[str, str]:
    """SHA-256 of every file below `folder`, relative name with / -> hexadecimal, sorted by name. Raises FileError."""
    folder = place(folder)
    if not folder.is_dir():
        raise FileError(f"{folder}: no such folder")
    names = [name for name in files_below(folder) if not is_hidden(name)]
    return {
        name: hashlib.sha256(read_bytes(folder / name)).hexdigest() for name in names
    }


def is_hidden(name: str) -> bool:
    """Whether a relative name with / has a part that begins with a dot, as temporary files do."""
    return any(part.startswith(".") for part in name.split("/"))


def check_relative(name: str) -> str:
    """`name` if it is a relative path with / that stays below its folder. Raises InputError."""
    if any(
        part in ("", ".", "..") or "\\" in part or "\0" in part
        for part in name.split("/")
    ):
        raise InputError(f"{name!r} is not a plain relative name")
    return name


def _checked(files: Iterable[tuple[str, bytes]]) -> Iterator[tuple[str, bytes]]:
    names = set()
    for name, data in files:
        if check_relative(name) in names:
            raise InputError(
                f"two files would be named {name}; rename one of the samples"
            )
        names.add(name)
        yield name, data


def _write(path: Path, data: bytes, flush: bool) -> None:
    if flush:
        _write_and_flush(path, data)
    else:
        path.write_bytes(data)


def _write_and_flush(path: Path, data: bytes) -> None:
    with path.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


def _flush_folder(folder: Path) -> None:
    # A rename is durable only once its folder is flushed; some file systems refuse, and do not need it.
    with contextlib.suppress(OSError), contextlib.ExitStack() as stack:
        descriptor = os.open(folder, os.O_RDONLY)
        stack.callback(os.close, descriptor)
        os.fsync(descriptor)


def _temporary_name(path: Path, mark: str = _TEMPORARY) -> Path:
    return path.with_name(
        f".{path.name[:40]}{mark}{os.getpid()}-{secrets.token_hex(4)}"
    )


def _remove(path: Path) -> None:
    shutil.rmtree(path, ignore_errors=True)  # does nothing for a file or a link
    with contextlib.suppress(OSError):
        path.unlink()


@contextlib.contextmanager
def _temporary(path: Path) -> Iterator[Path]:
    """A temporary name in the folder of `path`, removed on any exception; errors as OutputError."""
    try:
        with contextlib.ExitStack() as stack:
            temporary = _temporary_name(path)
            stack.callback(_remove, temporary)
            yield temporary
            stack.pop_all()
    except (OutputError, InputError):
        raise
    except (OSError, ValueError) as error:
        raise _not_written(path, error) from error


def _not_written(path: Path, error: Exception) -> OutputError:
    number = getattr(error, "errno", None) or 0
    if number in (errno.ENOTDIR, errno.EEXIST):
        return OutputError(f"{existing_part(path)}: {A_FILE}")
    reason = getattr(error, "strerror", None) or error
    remedy = _REMEDIES.get(number, f"{reason}: check the path")
    return OutputError(f"{path}: cannot be written; {remedy}")
