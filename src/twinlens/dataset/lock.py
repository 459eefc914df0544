"""One run at a time: a lock on a folder of results, which the system lets go when its process ends, however it ends."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from twinlens.dataset.storage import Place, RemotePath
from twinlens.errors import OutputError

WAIT = "wait for it"
"""What whoever comes second can do in any case."""


@contextlib.contextmanager
def locked(
    folder: Place, shared: bool = False, wait: bool = False, remedy: str = WAIT, file: str = ""
) -> Iterator[None]:
    """Hold the lock of `folder`, or of one `file` in it; `shared` with others that hold it so, as shards do.

    Raises OutputError, ending in the `remedy`, when another run holds it, unless asked to `wait` for that. Buckets and
    file systems without locks are not locked.
    """
    if isinstance(folder, RemotePath):
        yield
        return
    import fcntl  # here, so that what never locks works on systems without it

    how = (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | (0 if wait else fcntl.LOCK_NB)
    lock, told = folder / (f".{file}.lock" if file else ".lock"), folder / file if file else folder
    while not _is_there(lock, descriptor := _taken(lock, told, how, remedy)):
        os.close(descriptor)  # whoever held it before has removed it: nobody else sees this one
    try:
        yield
    finally:
        if not shared:
            lock.unlink(missing_ok=True)
        os.close(descriptor)


def _taken(lock: Path, told: Path, how: int, remedy: str) -> int:
    """The descriptor of the lock's file, locked."""
    try:
        lock.parent.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(lock, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        raise OutputError(f"{lock.parent}: cannot be written; {error.strerror}") from error
    try:
        _take(descriptor, told, how, remedy)
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor


def _is_there(lock: Path, descriptor: int) -> bool:
    """Whether the open file is the one that the folder holds."""
    try:
        return os.path.samestat(lock.stat(), os.fstat(descriptor))
    except FileNotFoundError:
        return False


def _take(descriptor: int, told: Path, how: int, remedy: str) -> None:
    import fcntl

    try:
        fcntl.flock(descriptor, how)
    except BlockingIOError:
        raise OutputError(f"{told}: another run is writing there; {remedy}") from None
    except OSError:
        return  # a file system that knows no locks
