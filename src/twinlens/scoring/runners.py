"""Runs matchers: in this process (`LocalRunner`), or in a worker process with time and memory limits (`WorkerRunner`).

Whatever a matcher raises or wrongly returns becomes a `MethodError` with a `Failure`.

The worker is one spawned process, kept between matches so that compiled code stays compiled. At a time limit it gets
SIGTERM, so that Python code can end its own programs and remove its files, and then SIGKILL, with every process in its
process group. Its output is discarded. If the machine runs out of memory, Linux kills the worker first. Methods must be
picklable, and scripts must guard their start with `if __name__ == "__main__":`.
"""

import concurrent.futures
import contextlib
import errno
import multiprocessing
import os
import pickle
import re
import signal
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn, Protocol

import numpy as np
import pebble
from numpy.typing import NDArray

from twinlens.errors import InputError, TwinlensError
from twinlens.matching.external import WrongAnswerError
from twinlens.scoring.board import Failure

WARM_UP_ROWS = 32
START_LIMIT_S = 60.0
"""Time that a new worker has to import what it needs."""
LONGEST_LIMIT_S = 1e6

Image = NDArray[Any]
Search = Mapping[str, int]
"""Keyword arguments of a match: num_disparities and min_disparity."""


class Method(Protocol):
    """A matcher with a name."""

    @property
    def name(self) -> str:
        """Name on the board."""
        ...

    def match(self, left: Image, right: Image, *, num_disparities: int, min_disparity: int) -> Image:
        """Disparity (H, W) float32 in pixels, +inf unknown, of two uint8 or uint16 images (H, W[, 3]).

        The search covers min_disparity to min_disparity + num_disparities - 1.
        """
        ...


@dataclass(frozen=True)
class Answer:
    """A validated disparity map and the wall time of its match in seconds."""

    disp: Image
    seconds: float | None


class MethodError(Exception):
    """A method failed on a pair; see `failure`."""

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.failure = Failure(kind, " ".join(message.split())[:300] or kind)


def timed_match(method: Method, left: Image, right: Image, search: Search) -> Answer:
    """One timed match; MethodError for any exception or invalid result."""
    start = time.perf_counter()
    try:
        found = method.match(left, right, **search)
    except TimeoutError as error:
        raise MethodError("time-limit", str(error)) from error
    except WrongAnswerError as error:
        raise MethodError(error.kind, str(error)) from error
    except (Exception, SystemExit) as error:
        raise _method_error(error) from error
    return Answer(_checked(found, left.shape[:2]), time.perf_counter() - start)


def warm_up(method: Method, left: Image, right: Image, search: Search) -> None:
    """Match a few rows so that compilation is not timed. The result, or exception, is ignored."""
    with contextlib.suppress(Exception, SystemExit):
        method.match(left[:WARM_UP_ROWS].copy(), right[:WARM_UP_ROWS].copy(), **search)


def missing_requirement(method: Any) -> str | None:
    """What `method` needs and does not find (a file, a function, a program), by its `check_parts`; None if nothing."""
    try:
        getattr(method, "check_parts", bool)()
    except TwinlensError as error:
        return None if _method_error(error).failure.kind == "memory" else str(error)
    except (Exception, SystemExit):
        return None  # the match will fail with the same error
    return None


class LocalRunner:
    """Runs methods in this process, without limits."""

    def __init__(self) -> None:
        self._warm: set[tuple[str, int]] = set()

    def __enter__(self) -> "LocalRunner":
        return self

    def __exit__(self, *_: object) -> None:
        return None

    def missing_requirement(self, method: Any) -> str | None:
        """See `missing_requirement`."""
        return missing_requirement(method)

    def warm_up(self, method: Method, left: Image, right: Image, search: Search) -> None:
        """See `warm_up`; once for each method and number of disparities."""
        key = method.name, search["num_disparities"]
        if key not in self._warm:
            self._warm.add(key)
            warm_up(method, left, right, search)

    def match(self, method: Method, left: Image, right: Image, search: Search) -> Answer:
        """See `timed_match`."""
        return timed_match(method, left, right, search)


class WorkerRunner:
    """Runs methods in a worker process.

    limit: seconds per match, plus `method.grace_s` for methods that enforce it themselves. warm_up_limit: seconds of a
    warm-up. memory_limit: bytes of data that the worker, and each process it starts, may allocate; None: no limit.
    """

    def __init__(self, limit: float, warm_up_limit: float, memory_limit: int | None = None) -> None:
        if not (0 < limit <= LONGEST_LIMIT_S and 0 < warm_up_limit <= LONGEST_LIMIT_S):
            raise InputError(
                f"time limits are {limit} and {warm_up_limit} s: expected more than 0, at most {LONGEST_LIMIT_S:g}"
            )
        if memory_limit is not None and not memory_limit > 0:
            raise InputError(f"memory_limit is {memory_limit} bytes: expected more than 0")
        self.limit, self.warm_up_limit, self.memory_limit = limit, warm_up_limit, memory_limit
        self._pool: pebble.ProcessPool | None = None
        self._pid = 0
        self._warm: set[tuple[str, int]] = set()
        self._warm_up_s: dict[str, float] = {}
        self._skip_warm_up: set[str] = set()

    def __enter__(self) -> "WorkerRunner":
        return self

    def __exit__(self, *_: object) -> None:
        self._stop()

    def missing_requirement(self, method: Any) -> str | None:
        """See the function; run in the worker, because it imports foreign modules. None if the worker hangs or dies."""
        if not hasattr(method, "check_parts"):
            return None
        try:
            found: str | None = self._run(self.warm_up_limit, missing_requirement, method)
        except MethodError:
            return None
        return found

    def warm_up(self, method: Method, left: Image, right: Image, search: Search) -> None:
        """See the function; once for each method and number of disparities in every new worker.

        Not repeated for a method whose warm-up hung, or took longer than the time limit and did not help.
        """
        self._started()
        name, key = method.name, (method.name, search["num_disparities"])
        if key in self._warm or name in self._skip_warm_up:
            return
        start, hung = time.monotonic(), False
        try:
            self._run(self.warm_up_limit, warm_up, method, left, right, search)
            self._warm.add(key)
        except MethodError as error:
            hung = error.failure.kind == "time-limit"
        self._warm_up_s[name] = self.warm_up_limit if hung else time.monotonic() - start
        if hung:
            self._skip_warm_up.add(name)

    def match(self, method: Method, left: Image, right: Image, search: Search) -> Answer:
        """See `timed_match`; run in the worker under the time limit."""
        limit = self.limit + float(getattr(method, "grace_s", 0.0))
        warm_up_note = self._warm_up_note(method.name, search["num_disparities"])
        try:
            answer: Answer = self._run(limit, timed_match, method, left, right, search)
        except MethodError as error:
            if self._warm_up_s.get(method.name, 0.0) > self.limit:
                self._skip_warm_up.add(method.name)
            if error.failure.kind == "time-limit":
                raise MethodError("time-limit", f"{error}{warm_up_note}") from error
            raise
        return answer

    def _warm_up_note(self, name: str, num_disparities: int) -> str:
        """What happened in the warm-up, for the message of a time limit."""
        took = self._warm_up_s.get(name)
        if took is None:
            return ""
        if (name, num_disparities) in self._warm:
            return f" after a warm-up of {took:.3g} s"
        hung = took >= self.warm_up_limit
        return f"; the warm-up {'exceeded' if hung else 'took'} {took:.3g} s and was not repeated"

    def _run(self, limit: float, function: Callable[..., Any], method: Any, *arguments: Any) -> Any:
        try:
            pickled = pickle.dumps(method)
        except Exception as error:
            message = f"cannot be sent to a worker process, run it without a time limit: {error}"
            raise MethodError("crash", message) from error
        future = self._started().schedule(_run_in_worker, (function, pickled, *arguments), timeout=limit)
        outcome = self._result(future, limit)
        if isinstance(outcome, Failure):
            raise MethodError(outcome.kind, outcome.message)
        return outcome

    def _result(self, future: Any, limit: float) -> Any:
        """The result of a task; if it failed, the worker is stopped and MethodError raised."""
        try:
            return future.result(limit + START_LIMIT_S)
        except concurrent.futures.TimeoutError:
            error = MethodError("time-limit", f"exceeded the time limit of {limit:g} s")
        except pebble.ProcessExpired as expired:
            error = MethodError("crash", f"its process died ({_exit_text(expired.exitcode)})")
        except BrokenProcessPool:
            error = MethodError("memory", "its process died while it received the images, probably out of memory")
        self._stop()
        raise error from None

    def _started(self) -> pebble.ProcessPool:
        if self._pool is not None and self._pool.active:
            return self._pool
        self._stop()
        pool = self._pool = pebble.ProcessPool(max_workers=1, context=multiprocessing.get_context("spawn"))
        future = pool.schedule(_prepare_worker, (self.memory_limit,), timeout=START_LIMIT_S)
        try:
            started = future.result(2 * START_LIMIT_S)
        except (concurrent.futures.TimeoutError, pebble.ProcessExpired, BrokenProcessPool):
            self._stop()
            raise InputError(
                'limits need a worker process: guard the script with `if __name__ == "__main__":`'
            ) from None
        if isinstance(started, Failure):
            self._stop()
            raise MethodError(started.kind, started.message)
        self._pid = started
        return pool

    def _stop(self) -> None:
        """End the worker and its process group."""
        pool, pid = self._pool, self._pid
        self._pool, self._pid = None, 0
        self._warm.clear()
        if pool is not None:
            pool.stop()  # type: ignore[no-untyped-call]
            pool.join()
        if pid and hasattr(os, "killpg"):
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(pid, signal.SIGKILL)


def _checked(found: Any, shape: tuple[int, int]) -> Image:
    """A method's result, if it is an (H, W) float map without NaN and -inf; MethodError otherwise."""
    if not isinstance(found, np.ndarray) or found.dtype.kind != "f":
        what = f"an array of {found.dtype}" if isinstance(found, np.ndarray) else type(found).__name__
        raise MethodError("wrong-type", f"returned {what}: expected a float32 array of disparities")
    if found.shape != shape:
        raise MethodError("wrong-shape", f"returned shape {found.shape}: expected {shape}")
    wrong = int(np.count_nonzero(np.isnan(found) | np.isneginf(found)))
    if wrong:
        raise MethodError("not-a-number", f"NaN or -inf at {wrong} of {found.size} pixels: unknown is +inf")
    return found.astype(np.float32, copy=False)


def _method_error(error: BaseException, prefix: str = "") -> MethodError:
    """Kind "memory" if a lack of memory is among the causes of the exception, else "crash"."""
    cause = next((cause for cause in _causes(error) if _is_out_of_memory(cause)), None)
    if cause is not None:
        return MethodError("memory", f"{prefix}ran out of memory: {cause}".rstrip(": "))
    return MethodError("crash", f"{prefix}{type(error).__name__}: {error}")


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        yield error
        error = error.__cause__ or error.__context__


def _is_out_of_memory(error: BaseException) -> bool:
    """MemoryError, ENOMEM, or the dynamic loader's message, which has no code."""
    if isinstance(error, OSError) and error.errno == errno.ENOMEM:
        return True
    return isinstance(error, MemoryError) or (isinstance(error, ImportError) and "failed to map segment" in str(error))


def _exit_text(code: int) -> str:
    """How a process ended.

    >>> _exit_text(3), _exit_text(-11), _exit_text(-9)
    ('exit code 3', 'signal 11, SIGSEGV', 'signal 9, SIGKILL; possibly out of memory')
    """
    if code >= 0:
        return f"exit code {code}"
    with contextlib.suppress(ValueError):
        name = signal.Signals(-code).name
        return f"signal {-code}, {name}" + ("; possibly out of memory" if name == "SIGKILL" else "")
    return f"signal {-code}"


class _TerminatedError(BaseException):
    """SIGTERM in the worker; not an Exception, so that no method handles it."""


_loaded: dict[bytes, Any] = {}
"""In the worker: methods by their pickled form."""


def _prepare_worker(memory_limit: int | None) -> int | Failure:
    """The first task of a worker: a process group, no output, its limits. Returns its process id."""
    if hasattr(os, "setsid"):
        os.setsid()
    with Path(os.devnull).open("w") as null:
        for stream in (1, 2):
            os.dup2(null.fileno(), stream)
    signal.signal(signal.SIGTERM, _terminate)
    with contextlib.suppress(OSError):  # Linux only
        Path("/proc/self/oom_score_adj").write_text("1000")
    if memory_limit is not None:
        used = _data_bytes()
        if used > memory_limit:
            needs = f"a worker process needs {used / 2**30:.2f} GiB before the first match"
            return Failure("memory", f"{needs}; the limit is {memory_limit / 2**30:.2g} GiB")
        import resource

        hard = resource.getrlimit(resource.RLIMIT_DATA)[1]
        soft = memory_limit if hard == resource.RLIM_INFINITY else min(memory_limit, hard)
        resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))
    return os.getpid()


def _data_bytes() -> int:
    """Bytes of data of this process, as RLIMIT_DATA counts them; 0 if unknown (not Linux)."""
    with contextlib.suppress(OSError):
        found = re.search(r"^VmData:\s*(\d+) kB", Path("/proc/self/status").read_text(), re.MULTILINE)
        return int(found[1]) * 1024 if found else 0
    return 0


def _terminate(*_: object) -> NoReturn:
    raise _TerminatedError


def _run_in_worker(function: Callable[..., Any], pickled: bytes, *arguments: Any) -> Any:
    """`function(method, *arguments)`, or the Failure."""
    try:
        if pickled not in _loaded:
            try:
                _loaded[pickled] = pickle.loads(pickled)
            except Exception as error:
                raise _method_error(error, "cannot be loaded in a worker process: ") from error
        return function(_loaded[pickled], *arguments)
    except MethodError as error:
        return error.failure
    except _TerminatedError:
        os._exit(128 + signal.SIGTERM)
