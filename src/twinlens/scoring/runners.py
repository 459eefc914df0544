"""Runs matchers in this process, or in a worker process with time and memory limits (docs/decisions/process-pool.md).

Whatever a matcher raises or wrongly returns becomes a `MethodError` with a `Failure`.
"""

import contextlib
import errno
import functools
import multiprocessing
import os
import pickle
import re
import signal
import time
from collections.abc import Callable, Mapping
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pebble
from numpy.typing import NDArray

from twinlens.errors import InputError, TwinlensError
from twinlens.matching import Matcher
from twinlens.matching.contract import (
    Answer,
    WrongAnswerError,
    answer_of,
    checked_answer,
)
from twinlens.matching.external import FunctionError, format_status
from twinlens.scoring.board import Failure
from twinlens.scoring.samples import Pair

WARM_UP_ROWS = 32
WARM_UP_LIMIT_S = 120.0
WORKER_LIMIT_S = 600.0  # of a match if only a memory limit was given
START_LIMIT_S = 60.0  # for the imports of a new worker
LONGEST_LIMIT_S = 1e6

Image = NDArray[Any]


class Method(Matcher, Protocol):
    """A matcher with a name, which is its name on the board."""

    @property
    def name(self) -> str: ...


@dataclass(frozen=True)
class Match:
    """The validated answer of a method for a pair, and its wall time in seconds; None for maps of a submission."""

    answer: Answer
    seconds: float | None


class MethodError(Exception):
    """A method failed on a pair; see `failure`."""

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(
            kind, message
        )  # both, because the worker sends the exception as a pickle
        self.failure = Failure(kind, " ".join(message.split())[:300] or kind)


class Runner:
    """Runs methods in this process or, with a limit, in a worker process, kept so that compiled code stays compiled.

    Methods in a worker must be picklable, and scripts must guard their start with `if __name__ == "__main__":`. At a
    limit the worker gets SIGTERM, so that Python code can end its own programs, and then its process group SIGKILL.

    limit: seconds per match, plus `method.grace_s` for methods that enforce it themselves. memory_limit: bytes of data
    that the worker, and each process it starts, may allocate; alone it implies a limit of 600 s. None: no limit.
    warms_up: match a few rows before the first match of each method and number of disparities, so that compilation is
    not timed. In a worker this may take `warm_up_limit` seconds. A new worker repeats it, unless it exceeded
    `warm_up_limit`, or took longer than `limit` and the match failed nevertheless.
    """

    def __init__(
        self,
        limit: float | None,
        memory_limit: float | None,
        warms_up: bool,
        warm_up_limit: float,
    ) -> None:
        if limit is None and memory_limit is not None:
            limit = WORKER_LIMIT_S
        if limit is not None and not (
            0 < limit <= LONGEST_LIMIT_S and 0 < warm_up_limit <= LONGEST_LIMIT_S
        ):
            raise InputError(
                f"time limits are {limit} and {warm_up_limit} s: expected more than 0, at most {LONGEST_LIMIT_S:g}"
            )
        if memory_limit is not None and not memory_limit > 0:
            raise InputError(
                f"memory_limit is {memory_limit} bytes: expected more than 0"
            )
        self.limit, self.memory_limit, self.warms_up, self.warm_up_limit = (
            limit,
            memory_limit,
            warms_up,
            warm_up_limit,
        )
        self._pool: pebble.ProcessPool | None = None
        self._pid = 0
        self._warm: set[tuple[str, int]] = set()
        self._warm_up_s: dict[str, float] = {}
        self._skip_warm_up: set[str] = set()

    def check_parts(self, method: Any) -> None:
        """Raise InputError for what `method` needs and does not find (a file, a function, a program).

        If the check fails in another way, the match fails with the same error.
        """
        if hasattr(method, "check_parts"):
            with contextlib.suppress(MethodError):
                self._run(self.warm_up_limit, _check_parts, method)

    def match(self, method: Method, sample: Pair) -> Match:
        """One timed match; MethodError for any exception, an invalid result, or an exceeded limit."""
        arguments = (
            np.array(sample.im0),
            np.array(sample.im1),
            sample.search,
        )  # copies: a method may write into them
        if self.warms_up:
            self._warm_up(method, *arguments)
        if self.limit is None:
            return _timed_match(method, *arguments)
        took, skipped = (
            self._warm_up_s.get(method.name),
            method.name in self._skip_warm_up,
        )
        limit = self.limit + float(getattr(method, "grace_s", 0.0))
        try:
            match: Match = self._run(limit, _timed_match, method, *arguments)
        except MethodError as error:
            if took is not None and took > self.limit:
                self._skip_warm_up.add(method.name)
            if took is None or error.failure.kind != "time-limit":
                raise
            note = f"; the warm-up took {took:.3g} s" + (
                " and was not repeated" if skipped else ""
            )
            raise MethodError("time-limit", error.failure.message + note) from error
        return match

    def _warm_up(
        self, method: Method, left: Image, right: Image, search: Mapping[str, int]
    ) -> None:
        if self.limit is not None:
            self._started()
        name, key = method.name, (method.name, search["num_disparities"])
        if key in self._warm or name in self._skip_warm_up:
            return
        rows, start = (
            (left[:WARM_UP_ROWS].copy(), right[:WARM_UP_ROWS].copy()),
            time.monotonic(),
        )
        try:
            self._run(self.warm_up_limit, _untimed_match, method, *rows, search)
            self._warm.add(key)
        except MethodError as error:
            if error.failure.kind == "time-limit":
                self._skip_warm_up.add(name)
        self._warm_up_s[name] = time.monotonic() - start

    def _run(
        self, limit: float, function: Callable[..., Any], method: Any, *arguments: Any
    ) -> Any:
        """`function(method, *arguments)`; if the worker has to be stopped, MethodError."""
        if self.limit is None:
            return function(method, *arguments)
        try:
            pickled = pickle.dumps(method)
        except Exception as error:
            message = f"cannot be sent to a worker process, run it without a time limit: {error}"
            raise MethodError("crash", message) from error
        future = self._started().schedule(
            _run_in_worker, (function, pickled, *arguments), timeout=limit
        )
        try:
            return future.result(limit + START_LIMIT_S)
        except TimeoutError:
            failure = MethodError(
                "time-limit", f"exceeded the time limit of {limit:g} s"
            )
        except pebble.ProcessExpired as expired:
            failure = MethodError(
                "crash", f"its process {format_status(expired.exitcode)}"
            )
        except BrokenProcessPool:
            failure = MethodError(
                "memory",
                "its process died while it received the images, probably out of memory",
            )
        self.close()
        raise failure

    def _started(self) -> pebble.ProcessPool:
        if self._pool is not None and self._pool.active:
            return self._pool
        self.close()
        pool = self._pool = pebble.ProcessPool(
            max_workers=1, context=multiprocessing.get_context("spawn")
        )
        future = pool.schedule(
            _prepare_worker, (self.memory_limit,), timeout=START_LIMIT_S
        )
        try:
            self._pid = future.result(2 * START_LIMIT_S)
        except MethodError:
            self.close()
            raise
        except (TimeoutError, pebble.ProcessExpired, BrokenProcessPool):
            self.close()
            note = 'limits need a worker process: guard the script with `if __name__ == "__main__":`'
            raise InputError(note) from None
        return pool

    def close(self) -> None:
        """End the worker and its process group."""
        pool, pid = self._pool, self._pid
        self._pool, self._pid = None, 0
        if pool is not None:
            self._warm.clear()
            pool.stop()  # type: ignore[no-untyped-call]
            pool.join()
        if pid and hasattr(os, "killpg"):
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(pid, signal.SIGKILL)


def _timed_match(
    method: Method, left: Image, right: Image, search: Mapping[str, int]
) -> Match:
    start = time.perf_counter()
    try:
        result = answer_of(method, left, right, **search)
        seconds = time.perf_counter() - start
        _check_floats(result)
        answer = checked_answer(result, left.shape[:2], method.name)
        return Match(answer, seconds)
    except (Exception, SystemExit) as raised:
        error = (isinstance(raised, FunctionError) and raised.__cause__) or raised
        if isinstance(error, TimeoutError):
            raise MethodError("time-limit", str(error)) from error
        if isinstance(error, WrongAnswerError):
            raise MethodError(error.kind, str(error)) from error
        raise _method_error(error) from error


def _untimed_match(
    method: Method, left: Image, right: Image, search: Mapping[str, int]
) -> None:
    with contextlib.suppress(Exception, SystemExit):
        answer_of(method, left, right, **search)


def _check_floats(result: Any) -> None:
    """Refuse integers, which are a map that was scaled for a file and not converted back."""
    disparity = result[0] if isinstance(result, tuple) else result
    if isinstance(disparity, np.ndarray) and disparity.dtype.kind != "f":
        raise WrongAnswerError(
            "wrong-type",
            f"returned an array of {disparity.dtype}: expected float32 disparities",
        )


def _check_parts(method: Any) -> None:
    try:
        method.check_parts()
    except (Exception, SystemExit) as error:
        failure = _method_error(error)
        if isinstance(error, TwinlensError) and failure.failure.kind != "memory":
            raise InputError(str(error)) from error
        raise failure from error


def _method_error(error: BaseException, prefix: str = "") -> MethodError:
    """Kind "memory" if a lack of memory is among the causes of the exception, else "crash"."""
    causes = [error]
    while (
        cause := causes[-1].__cause__ or causes[-1].__context__
    ) is not None and cause not in causes:
        causes.append(cause)
    for cause in causes:
        unmapped = isinstance(cause, ImportError) and "failed to map segment" in str(
            cause
        )  # by the dynamic loader
        if (
            isinstance(cause, MemoryError)
            or getattr(cause, "errno", None) == errno.ENOMEM
            or unmapped
        ):
            return MethodError(
                "memory", f"{prefix}ran out of memory: {cause}".rstrip(": ")
            )
    return MethodError("crash", f"{prefix}{type(error).__name__}: {error}")


_load = functools.cache(pickle.loads)
"""In the worker: the method of a pickle, always the same object, so that what it has compiled or loaded is kept."""


def _prepare_worker(memory_limit: float | None) -> int:
    """The first task of a worker: a process group, no output, its limits. Returns its process id."""
    if hasattr(os, "setsid"):
        os.setsid()
    with Path(os.devnull).open("w") as null:
        for stream in (1, 2):
            os.dup2(null.fileno(), stream)
    signal.signal(
        signal.SIGTERM, signal.default_int_handler
    )  # KeyboardInterrupt: no `except Exception` handles it
    with contextlib.suppress(OSError):  # Linux only
        Path("/proc/self/oom_score_adj").write_text("1000")
    if memory_limit is not None:
        _limit_memory(memory_limit)
    return os.getpid()


def _limit_memory(limit: float) -> None:
    """Limit this process's data; MethodError if it has more already."""
    import resource

    used = 0
    with contextlib.suppress(OSError):  # Linux only; what RLIMIT_DATA counts
        match = re.search(
            r"^VmData:\s*(\d+) kB", Path("/proc/self/status").read_text(), re.MULTILINE
        )
        used = int(match[1]) * 1024 if match else 0
    if used > limit:
        needs = f"a worker process needs {used / 2**30:.2f} GiB before the first match"
        raise MethodError("memory", f"{needs}; the limit is {limit / 2**30:.2g} GiB")
    hard = resource.getrlimit(resource.RLIMIT_DATA)[1]
    soft = int(limit if hard == resource.RLIM_INFINITY else min(limit, hard))
    resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))


def _run_in_worker(
    function: Callable[..., Any], pickled: bytes, *arguments: Any
) -> Any:
    try:
        try:
            method = _load(pickled)
        except Exception as error:
            raise _method_error(
                error, "cannot be loaded in a worker process: "
            ) from error
        return function(method, *arguments)
    except KeyboardInterrupt:
        os._exit(128 + signal.SIGTERM)
