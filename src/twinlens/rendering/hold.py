"""Holding Ctrl-C back while compiled modules set themselves up: halfway, they leave a process that is of no use."""

import contextlib
import signal
import threading
from collections.abc import Iterator


@contextlib.contextmanager
def interrupts_held() -> Iterator[None]:
    """Keep SIGINT until the block has ended, then let its handler hear it once, however often it came.

    Only the main thread may set handlers, and only it runs them: elsewhere nothing is held. A process that ignores
    SIGINT, dies of it (SIG_DFL), or handles it outside Python goes on doing so.
    """
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield
        return
    came = threading.Event()
    signal.signal(signal.SIGINT, lambda *_: came.set())
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        if came.is_set():
            signal.raise_signal(signal.SIGINT)
