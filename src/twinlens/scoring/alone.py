"""One run at a time in a folder of boards: whichever ended last would write its own entries alone."""

import contextlib
from collections.abc import Iterator
from contextvars import ContextVar
from pathlib import Path

from twinlens.dataset.lock import locked

_HELD: ContextVar[frozenset[Path]] = ContextVar("held", default=frozenset())
"""The folders whose locks this thread of work holds: what it calls may go in, and another thread may not."""


@contextlib.contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Be the only run that writes boards in `folder`, of the command line's and of `run_benchmark`'s.

    Whoever is alone there already goes in again. A folder that is not there is made, and removed where nothing came
    into it, with those above it. Raises OutputError where another run is writing, or the folder cannot be made.
    """
    place = folder.absolute()
    if place in _HELD.get():
        yield
        return
    missing = [each for each in (place, *place.parents) if not each.is_dir()]
    try:
        with locked(folder), _holding(place):
            yield
    finally:
        for each in missing:
            with contextlib.suppress(OSError):
                each.rmdir()


@contextlib.contextmanager
def _holding(place: Path) -> Iterator[None]:
    token = _HELD.set(_HELD.get() | {place})
    try:
        yield
    finally:
        _HELD.reset(token)
