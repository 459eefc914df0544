"""Processes and signals: workers with limits, programs, and blocks of code that Ctrl-C may not leave half done.

A `Worker` is one process of this interpreter, which runs functions one after another. An `IsolatedWorker` runs code of
users: with limits of time and memory, without output, and such that nothing that it starts outlives it. `run_program`
runs a program of a user. Why Pebble, and why one pool for each process: docs/decisions/process-pool.md.
"""

import contextlib
import os
import re
import signal
import subprocess
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import (
    active_children,
    connection,
    parent_process,
    resource_tracker,
)
from multiprocessing.context import SpawnContext, SpawnProcess
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from twinlens.errors import InputError

START_LIMIT_S = 60.0  # for the imports of a new worker
TAIL_BYTES = 4096  # of a program's output
_CHILD_S = 0.1  # seconds to wait for output after a program has ended: its children may keep the pipe open
_SAFE_PATH = (
    "PYTHONSAFEPATH"  # a variable: Python does not import from the current folder
)
_starting = threading.RLock()  # while a process of Python or a program starts


class WorkerDiedError(Exception):
    """A worker process ended while it ran a function, or before it began: while it received the arguments.

    status: its exit status; None if that is not known.
    """

    def __init__(self, status: int | None, began: bool) -> None:
        super().__init__(status, began)
        self.status = status
        self.began = began

    @property
    def was_killed(self) -> bool:
        """Whether a signal ended it, such as that of a segmentation fault."""
        return self.status is not None and self.status < 0


class MemoryLimitError(Exception):
    """A process needs more memory before its first function than the limit allows."""


def format_status(status: int) -> str:
    """How a process ended, from its exit status; negative: a signal.

    >>> format_status(3), format_status(-9)
    ('exited with status 3', 'was killed by SIGKILL (out of memory?)')
    """
    if status >= 0:
        return f"exited with status {status}"
    names = {kind.value: kind.name for kind in signal.Signals}
    name = names.get(-status, f"signal {-status}")
    hint = " (out of memory?)" if name == "SIGKILL" else ""
    return f"was killed by {name}{hint}"


@contextlib.contextmanager
def _safe_path() -> Iterator[str | None]:
    """Processes of Python that start within import nothing from the current folder, whose files may be of strangers.

    multiprocessing starts Python by `python -c`, which would search modules there first, even those of Python itself.
    Gives the value of the variable before.
    """
    with _starting:
        before = os.environ.get(_SAFE_PATH)
        os.environ[_SAFE_PATH] = "1"
        try:
            yield before
        finally:
            _restore_safe_path(before)


def _restore_safe_path(before: str | None) -> None:
    if before is None:
        os.environ.pop(_SAFE_PATH, None)
    else:
        os.environ[_SAFE_PATH] = before


class _SafeProcess(SpawnProcess):
    """A spawned process that starts in `_safe_path`. Its `sys.path` and its variables are those of its parent."""

    _before: str | None = None

    def start(self) -> None:
        with _safe_path() as self._before:
            super().start()

    def run(self) -> None:
        # Programs that it starts, such as `python matcher.py`, may import what lies beside them.
        _restore_safe_path(self._before)
        super().run()


class _SafeContext(SpawnContext):
    Process = _SafeProcess


def _start_tracker() -> None:
    """Start the process by which multiprocessing tracks its semaphores, if it does not run."""
    with _safe_path():
        resource_tracker.ensure_running()


class Worker:
    """One spawned process that runs functions in turn. A process that has died is not replaced.

    renewed_after: the number of functions after which a new process takes its place, 0 for never. initializer: called
    first in each process. Scripts must guard their start with `if __name__ == "__main__":`.
    """

    def __init__(
        self, *, renewed_after: int = 0, initializer: Callable[[], None] | None = None
    ) -> None:
        import pebble

        _start_tracker()
        self._pool = pebble.ProcessPool(
            1, renewed_after, initializer=initializer, context=_SafeContext()
        )

    @property
    def active(self) -> bool:
        """Whether it takes functions; starts the process."""
        return bool(self._pool.active)

    def submit(
        self,
        function: Callable[..., Any],
        *arguments: Any,
        limit_s: float | None = None,
    ) -> Future[Any]:
        """Run function(*arguments) in the process, which is ended after `limit_s` seconds.

        Raises RuntimeError if the process has died. See `is_lost` for what the future raises.
        """
        future: Future[Any] = self._pool.schedule(function, arguments, timeout=limit_s)
        return future

    def stop(self) -> None:
        """End the process: SIGTERM, then SIGKILL; does not wait for it."""
        self._pool.stop()  # type: ignore[no-untyped-call]

    def join(self) -> None:
        """Wait until the process has ended, after `stop`."""
        self._pool.join()


def is_lost(error: BaseException) -> bool:
    """Whether a worker died while it ran the function of a future that raised this."""
    import pebble

    return isinstance(error, pebble.ProcessExpired | BrokenProcessPool)


class IsolatedWorker(Worker):
    """A worker for code of users: in its own process group, without output, the first that Linux ends without memory.

    memory_limit: bytes of data that the process, and each process it starts, may allocate; None for no limit. At a time
    limit it gets SIGTERM, which raises KeyboardInterrupt in Python code, so that it can end its own programs, and then
    its process group gets SIGKILL.

    Raises MemoryLimitError if it needs more before its first function, and InputError if it cannot start.
    """

    def __init__(self, memory_limit: float | None) -> None:
        super().__init__()
        self._group = 0
        self._process: BaseProcess | None = None
        start = super().submit(_isolate, memory_limit, limit_s=START_LIMIT_S)
        try:
            self._group = start.result(2 * START_LIMIT_S)
            # Pebble does not report the status of a process that died while it was sent the arguments of a function.
            children = {child.pid: child for child in active_children()}
            self._process = children.get(self._group)
        except BaseException as error:
            self.end()
            if isinstance(error, TimeoutError) or is_lost(error):
                note = 'limits need a worker process: guard the script with `if __name__ == "__main__":`'
                raise InputError(note) from None
            raise

    def run(self, function: Callable[..., Any], *arguments: Any, limit_s: float) -> Any:
        """function(*arguments), as the process computes it. Raises TimeoutError and WorkerDiedError, and then ends."""
        import pebble

        future = self.submit(_run_or_exit, function, *arguments, limit_s=limit_s)
        try:
            return future.result(limit_s + START_LIMIT_S)
        except TimeoutError:
            self.end()
            raise
        except pebble.ProcessExpired as expired:
            self.end()
            raise WorkerDiedError(expired.exitcode, began=True) from None
        except BrokenProcessPool:
            status = self._exit_status()
            self.end()
            raise WorkerDiedError(status, began=False) from None

    def _exit_status(self) -> int | None:
        """The exit status of the process, if it ends within a second."""
        if self._process is None:
            return None
        self._process.join(1.0)
        return self._process.exitcode

    def end(self) -> None:
        """End the process and its group, and wait for it."""
        self.stop()
        self.join()
        if self._group and hasattr(os, "killpg"):
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(self._group, signal.SIGKILL)
        self._group = 0


def _run_or_exit(function: Callable[..., Any], *arguments: Any) -> Any:
    """Exit at SIGTERM: Pebble would send the KeyboardInterrupt to the parent as a result."""
    try:
        return function(*arguments)
    except KeyboardInterrupt:
        os._exit(128 + signal.SIGTERM)


def _isolate(memory_limit: float | None) -> int:
    """The first function of an isolated worker. Returns its process id, which is that of its process group."""
    if hasattr(os, "setsid"):
        os.setsid()
    with Path(os.devnull).open("w") as null:
        for stream in (1, 2):
            os.dup2(null.fileno(), stream)
    # KeyboardInterrupt: no `except Exception` handles it.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    end_first_without_memory("self")
    if memory_limit is not None:
        _limit_memory(memory_limit)
    return os.getpid()


def end_first_without_memory(process: object) -> None:
    """If memory runs out, Linux kills this process, an id or "self", before others."""
    with contextlib.suppress(OSError):
        Path(f"/proc/{process}/oom_score_adj").write_text("1000")


def _limit_memory(limit: float) -> None:
    """Limit this process's data; MemoryLimitError if it has more already."""
    import resource

    used = 0
    with contextlib.suppress(OSError):  # Linux only; what RLIMIT_DATA counts
        status = Path("/proc/self/status").read_text()
        data = re.search(r"^VmData:\s*(\d+) kB", status, re.MULTILINE)
        used = int(data[1]) * 1024 if data else 0
    if used > limit:
        needs = f"a worker process needs {used / 2**30:.2f} GiB before the first match"
        raise MemoryLimitError(f"{needs}; the limit is {limit / 2**30:.2g} GiB")
    hard = resource.getrlimit(resource.RLIMIT_DATA)[1]
    soft = int(limit if hard == resource.RLIM_INFINITY else min(limit, hard))
    resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))


def run_program(words: list[str], limit_s: float) -> tuple[int, str]:
    """Run a program without a shell: (exit status, the end of its output).

    It runs in its own session, so that its children are killed with it at the time limit. Raises TimeoutError at the
    limit, and OSError or ValueError if it cannot be started.
    """
    with _starting:
        process = subprocess.Popen(
            words,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            bufsize=0,
        )
    end_first_without_memory(process.pid)
    tail = bytearray()

    def drain() -> None:
        assert process.stdout is not None
        with process.stdout as pipe:
            while output := pipe.read(1 << 16):
                tail.extend(output)
                del tail[:-TAIL_BYTES]

    reader = threading.Thread(target=drain, daemon=True)
    reader.start()
    try:
        process.wait(limit_s)
    except subprocess.TimeoutExpired:
        raise TimeoutError from None
    finally:
        with deferred_interrupts():  # a second Ctrl-C
            if process.poll() is None:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
                process.wait()
    reader.join(_CHILD_S)
    return process.returncode, tail.decode(errors="replace")


def end_with_parent() -> None:
    """End this process as soon as its parent has died, even if the parent was killed. An initializer of workers."""

    def exit_after() -> None:
        parent = parent_process()
        if parent is not None:
            connection.wait([parent.sentinel])
            os._exit(1)

    threading.Thread(target=exit_after, name="twinlens-parent", daemon=True).start()


@contextlib.contextmanager
def blocked_interrupts() -> Iterator[None]:
    """Threads and processes started within never receive SIGINT, which a terminal sends to all of a command."""
    _start_tracker()  # its start would unblock SIGINT (CPython 3.11)
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextlib.contextmanager
def deferred_interrupts() -> Iterator[None]:
    """Defer SIGINT and SIGTERM until the end of the block, then raise the first of them.

    Only the main thread may set handlers, and runs them; in other threads nothing is deferred. Signals that the process
    ignores, leaves to SIG_DFL, or handles outside Python are not affected.
    """
    handlers: dict[signal.Signals, Any] = {}
    if threading.current_thread() is threading.main_thread():
        for kind in (signal.SIGINT, signal.SIGTERM):
            handler = signal.getsignal(kind)
            if callable(handler):
                handlers[kind] = handler
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
