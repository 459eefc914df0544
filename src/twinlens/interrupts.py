"""Blocks of code that Ctrl-C may not leave half done."""

import contextlib
import signal
import threading
from collections.abc import Iterator


@contextlib.contextmanager
def deferred_interrupts() -> Iterator[None]:
    """Defer SIGINT until the end of the block, then raise it once.

    Only the main thread may set handlers, and runs them; in other threads nothing is deferred. Processes that ignore
    SIGINT, use SIG_DFL, or handle it outside Python are not affected.
    """
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield
        return
    received = threading.Event()
    signal.signal(signal.SIGINT, lambda *_: received.set())
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        if received.is_set():
            signal.raise_signal(signal.SIGINT)
