"""Blocks of code that Ctrl-C may not leave half done."""

import contextlib
import signal
import threading
from collections.abc import Iterator


@contextlib.contextmanager
def deferred_interrupts() -> Iterator[None]:
    """Defer SIGINT and SIGTERM until the end of the block, then raise the first of them.

    Only the main thread may set handlers, and runs them; in other threads nothing is deferred. Signals that the process
    ignores, leaves to SIG_DFL, or handles outside Python are not affected.
    """
    kinds = (
        (signal.SIGINT, signal.SIGTERM)
        if threading.current_thread() is threading.main_thread()
        else ()
    )
    handlers = {
        kind: handler for kind in kinds if callable(handler := signal.getsignal(kind))
    }
    received: list[int] = []
    for kind in handlers:
        signal.signal(kind, lambda number, _: received.append(number))
    try:
        yield
    finally:
        for kind, handler in handlers.items():
            signal.signal(kind, handler)
        if received:
            signal.raise_signal(received[0])
