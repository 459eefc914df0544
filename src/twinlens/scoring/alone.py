"""One run at a time with a board: whichever ended last would write its own entries alone."""

import contextlib
from collections.abc import Iterator
from pathlib import Path

from twinlens.dataset.lock import locked


@contextlib.contextmanager
def alone(folder: Path, file: str = "") -> Iterator[None]:
    """Be the only run in a `folder`, as the command line's are, or with one board `file` of it, as `run_benchmark`'s.

    A folder that is not there is made, and removed where nothing came into it, with those above it. Raises OutputError
    where another run is writing, or the folder cannot be made.
    """
    missing = [each for each in (folder, *folder.parents) if not each.is_dir()]
    try:
        with locked(folder, file=file):
            yield
    finally:
        for each in missing:
            with contextlib.suppress(OSError):
                each.rmdir()
