"""A lock on a folder of results, so that one run writes there at a time. The system releases it when a process ends.

flock(2) rather than filelock: shards need a shared lock, and the lock file is removed (docs/decisions/locks.md).
"""

import contextlib
import os
from collections.abc import Iterator

from twinlens.dataset.storage import Place, RemotePath
from twinlens.errors import OutputError

WAIT = "wait for it"
"""The remedy that is always possible."""


@contextlib.contextmanager
def locked(
    folder: Place, shared: bool = False, wait: bool = False, remedy: str = WAIT, file: str = ""
) -> Iterator[None]:
    """Hold the lock of `folder`, or of one `file` in it; several processes can hold a `shared` one, as shards do.

    Raises OutputError, which ends with the `remedy`, while another run holds it, unless `wait` is set. Buckets and file
    systems without locks are not locked.
    """
    if isinstance(folder, RemotePath):
        yield
        return
    import fcntl  # not on Windows, where everything that needs no lock works

    lock = folder / (f".{file}.lock" if file else ".lock")
    operation = (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | (0 if wait else fcntl.LOCK_NB)
    while True:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            descriptor = os.open(lock, os.O_RDWR | os.O_CREAT, 0o666)
        except OSError as error:
            raise OutputError(f"{folder}: cannot be written; {error.strerror}") from error
        with contextlib.ExitStack() as stack:
            stack.callback(os.close, descriptor)
            try:
                fcntl.flock(descriptor, operation)
            except BlockingIOError:
                raise OutputError(f"{folder / file}: another run is writing there; {remedy}") from None
            except OSError:
                pass  # a file system without locks
            if os.fstat(descriptor).st_nlink == 0:
                continue  # the previous holder has removed this file: lock the new one
            if not shared:
                stack.callback(lock.unlink, missing_ok=True)
            yield
            return
