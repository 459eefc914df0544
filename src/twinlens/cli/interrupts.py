"""Ctrl-C: the first ends the work in good order; the second ends the process at once, with all that it started.

Only where the process is the command line's own: who calls `main` or `run` keeps his handlers. What is written is
written aside and renamed, so that an end at any moment leaves nothing half-written in its place. An end at once may
leave a folder behind among the system's temporary ones: twinlens-*, in which `twinlens.matching.program` ran a program.
"""

import atexit
import contextlib
import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NoReturn

INTERRUPTED = 130
"""The exit code, 128 + SIGINT, as shells have it."""
_SHOWN_AGAIN = "\r\x1b[2K\x1b[?25h"
"""Clears a progress bar's line, and shows the cursor that it hid (ECMA-48, DEC private mode 25)."""


class Ender:
    """The handler of SIGINT; `asked`: whether the first has come; `code`: the exit code, once all is done and said."""

    def __init__(self) -> None:
        self.asked = False
        self.code: int | None = None

    def __call__(self, *_: object) -> None:
        """KeyboardInterrupt the first time; the end of the process after it, and without a word once all is said."""
        if self.code is not None:
            end("", self.code)
        if self.asked:
            end()
        self.asked = True
        raise KeyboardInterrupt


def take_over() -> Ender:
    """Handle the interrupts of this process from now on. The last steps of its end, which are quick, hear none.

    A process that was started to hear none at all, as a script's in the background, goes on hearing none.
    """
    ender = Ender()
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        return ender
    signal.signal(signal.SIGINT, ender)
    atexit.register(signal.signal, signal.SIGINT, signal.SIG_IGN)
    return ender


def once_more(before: object) -> None:
    """A second interrupt, for a command that took the first as a wish to stop soon; `before`: the handler before it."""
    if isinstance(before, Ender):
        end()
    raise KeyboardInterrupt


def end(message: str = "twinlens: interrupted again; ended at once\n", code: int = INTERRUPTED) -> NoReturn:
    """Leave at once: no waiting, no tidying up, no word of Python's. What this process started is ended too."""
    try:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        for child in _descendants(os.getpid()):
            with contextlib.suppress(OSError):
                os.kill(child, signal.SIGKILL)
        with contextlib.suppress(OSError):
            shown = _SHOWN_AGAIN if message and os.isatty(2) else ""
            os.write(2, f"{shown}{message}".encode())
    finally:
        os._exit(code)


@contextlib.contextmanager
def saying(kept: Callable[[], str]) -> Iterator[None]:
    """Let an interrupt say what is kept of the work; nothing where `kept` gives an empty text."""
    try:
        yield
    except KeyboardInterrupt as error:
        raise KeyboardInterrupt(kept()) from error


def told(error: BaseException) -> str:
    """The line of an interrupt: what is kept, where a command said so. click wraps it in an error of its own.

    >>> told(KeyboardInterrupt()), told(KeyboardInterrupt("2 samples are kept"))
    ('interrupted', 'interrupted; 2 samples are kept')
    """
    cause = error if isinstance(error, KeyboardInterrupt) else error.__cause__
    kept = str(cause) if isinstance(cause, KeyboardInterrupt) else ""
    return f"interrupted; {kept}" if kept else "interrupted"


def _descendants(process: int) -> list[int]:
    """The processes that this one started, and those that they did, also in sessions of their own; Linux tells."""
    found = []
    with contextlib.suppress(OSError):  # they end while they are listed, too
        for tasks in Path(f"/proc/{process}/task").glob("*/children"):
            with contextlib.suppress(OSError, ValueError):
                for child in (int(word) for word in tasks.read_text().split()):
                    found += [child, *_descendants(child)]
    return found
