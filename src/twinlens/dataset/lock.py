"""One run at a time: a lock on a folder of results, which the system lets go when its process ends, however it ends."""

import contextlib
import fcntl
import os
from collections.abc import Iterator
from pathlib import Path

from twinlens.dataset.storage import Place, RemotePath
from twinlens.errors import OutputError

_NAME = ".lock"
WAIT = "wait for it"
"""What whoever comes second can do in any case."""


@contextlib.contextmanager
def locked(folder: Place, shared: bool = False, wait: bool = False, remedy: str = WAIT) -> Iterator[None]:
    """Hold the lock of `folder`; `shared` with others that hold it so, as the shards of a dataset do.

    Raises OutputError, ending in the `remedy`, when another run holds it, unless asked to `wait` for that. Buckets and
    file systems without locks are not locked.
    """
    if isinstance(folder, RemotePath):
        yield
        return
    how = (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | (0 if wait else fcntl.LOCK_NB)
    while not _is_there(folder, descriptor := _taken(folder, how, remedy)):
        os.close(descriptor)  # whoever held it before has removed it: nobody else sees this one
    try:
        yield
    finally:
        if not shared:
            (folder / _NAME).unlink(missing_ok=True)
        os.close(descriptor)


def _taken(folder: Path, how: int, remedy: str) -> int:
    """The descriptor of the lock's file, locked."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(folder / _NAME, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written; {error.strerror}") from error
    try:
        _take(descriptor, folder, how, remedy)
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor


def _is_there(folder: Path, descriptor: int) -> bool:
    """Whether the open file is the one that the folder holds."""
    try:
        return os.path.samestat((folder / _NAME).stat(), os.fstat(descriptor))
    except FileNotFoundError:
        return False


def _take(descriptor: int, folder: Place, how: int, remedy: str) -> None:
    try:
        fcntl.flock(descriptor, how)
    except BlockingIOError:
        raise OutputError(f"{folder}: another run is writing there; {remedy}") from None
    except OSError:
        return  # a file system that knows no locks
