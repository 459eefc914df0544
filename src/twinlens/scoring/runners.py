"""Runs matchers in this process, or in a worker process with time and memory limits (docs/decisions/process-pool.md).

Whatever a matcher raises or wrongly returns becomes a `MethodError` with a `MatchFailure`.
"""

import contextlib
import errno
import functools
import pickle
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

import twinlens
from twinlens.errors import InputError, TwinlensError
from twinlens.matching import Answer, Matcher
from twinlens.matching.contract import (
    MatcherFailedError,
    answer_of,
    checked_answer,
    unchecked_pair,
)
from twinlens.processes import (
    IsolatedWorker,
    MemoryLimitError,
    WorkerDiedError,
    format_status,
)
from twinlens.scoring.board import MatchFailure
from twinlens.scoring.samples import Pair

WARM_UP_ROWS = 32
WARM_UP_LIMIT_S = 120.0
WORKER_LIMIT_S = 600.0
"""Seconds per match if only a memory limit was given."""
LONGEST_LIMIT_S = 1e6
_FRAMES, _LONGEST_LINE = 4, 300
_PACKAGE = Path(twinlens.__file__).parent

Image = NDArray[Any]


class Method(Matcher, Protocol):
    """A matcher with a name, which is its name on the board."""

    @property
    def name(self) -> str: ...


@dataclass(frozen=True)
class Match:
    """The validated answer of a method for a pair, and its wall time in seconds; None for maps of a submission.

    right: the method's map of the right view, where it was asked for.
    """

    answer: Answer
    seconds: float | None
    right: NDArray[np.floating[Any]] | None = None


class MethodError(Exception):
    """A method failed on a pair; see `failure`."""

    def __init__(self, kind: str, message: str, frames: tuple[str, ...] = ()) -> None:
        # All arguments, because the worker sends the exception as a pickle.
        super().__init__(kind, message, frames)
        line = " ".join(message.split())[:300] or kind
        self.failure = MatchFailure(kind, line, frames)


class Runner:
    """Runs methods in this process or, with a limit, in a worker process, kept so that compiled code stays compiled.

    Methods in a worker must be picklable, and scripts must guard their start with `if __name__ == "__main__":`. What
    happens at a limit: `processes.IsolatedWorker`.

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
        limits_s = () if limit is None else (limit, warm_up_limit)
        if not all(0 < seconds <= LONGEST_LIMIT_S for seconds in limits_s):
            raise InputError(
                f"time limits are {limit} and {warm_up_limit} s: expected more than 0, at most {LONGEST_LIMIT_S:g}"
            )
        if memory_limit is not None and not memory_limit > 0:
            raise InputError(
                f"memory_limit is {memory_limit} bytes: expected more than 0"
            )
        self.limit = limit
        self.memory_limit = memory_limit
        self.warms_up = warms_up
        self.warm_up_limit = warm_up_limit
        self._worker: IsolatedWorker | None = None
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
        # Copies: a method may write into them.
        arguments = np.array(sample.im0), np.array(sample.im1), sample.search
        if self.warms_up:
            self._warm_up(method, *arguments)
        if self.limit is None:
            return _timed_match(method, *arguments)
        warm_up_s = self._warm_up_s.get(method.name)
        skipped = method.name in self._skip_warm_up
        limit = self.limit + float(getattr(method, "grace_s", 0.0))
        try:
            match: Match = self._run(limit, _timed_match, method, *arguments)
        except MethodError as error:
            if warm_up_s is not None and warm_up_s > self.limit:
                self._skip_warm_up.add(method.name)
            if warm_up_s is None or error.failure.kind != "time-limit":
                raise
            note = f"; the warm-up took {warm_up_s:.3g} s"
            if skipped:
                note += " and was not repeated"
            raise MethodError("time-limit", error.failure.message + note) from error
        return match

    def _warm_up(
        self, method: Method, left: Image, right: Image, search: Mapping[str, int]
    ) -> None:
        if self.limit is not None:
            self._started()  # a new worker forgets which methods are warm
        name, key = method.name, (method.name, search["num_disparities"])
        if key in self._warm or name in self._skip_warm_up:
            return
        rows = left[:WARM_UP_ROWS].copy(), right[:WARM_UP_ROWS].copy()
        start = time.monotonic()
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
        """`function(method, *arguments)`, in the worker if there is a limit; if it has to be ended, MethodError."""
        if self.limit is None:
            return function(method, *arguments)
        try:
            pickled = pickle.dumps(method)
        except Exception as error:
            message = f"cannot be sent to a worker process, run it without a time limit: {error}"
            raise MethodError("crash", message) from error
        try:
            return self._started().run(
                _call_in_worker, function, pickled, *arguments, limit_s=limit
            )
        except TimeoutError:
            message = f"exceeded the time limit of {limit:g} s"
            raise MethodError("time-limit", message) from None
        except WorkerDiedError as error:
            raise _error_of_death(error) from None

    def _started(self) -> IsolatedWorker:
        if self._worker is None or not self._worker.active:
            self.close()
            try:
                self._worker = IsolatedWorker(self.memory_limit)
            except MemoryLimitError as error:
                raise MethodError("memory", str(error)) from error
        return self._worker

    def close(self) -> None:
        """End the worker and its process group."""
        worker, self._worker = self._worker, None
        if worker is not None:
            self._warm.clear()
            worker.end()


def _error_of_death(error: WorkerDiedError) -> MethodError:
    """A process that ends by itself while it receives the images has no memory for them."""
    if error.began or error.was_killed:
        return MethodError("crash", f"its process {format_status(error.status or 0)}")
    message = "its process died while it received the images, probably out of memory"
    return MethodError("memory", message)


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
        error: BaseException = raised
        if isinstance(raised, MatcherFailedError):
            if raised.kind != "crash":
                raise MethodError(raised.kind, str(raised)) from raised
            # The exception of a user's function says more than its name in front.
            error = raised.__cause__ or raised
        if isinstance(error, TimeoutError):
            raise MethodError("time-limit", str(error)) from error
        raise _method_error(error) from error


def _untimed_match(
    method: Method, left: Image, right: Image, search: Mapping[str, int]
) -> None:
    with contextlib.suppress(Exception, SystemExit):
        answer_of(method, left, right, **search)


def _check_floats(result: Any) -> None:
    """Refuse integers, which are a map that was scaled for a file and not converted back."""
    disparity, _ = unchecked_pair(result)
    if isinstance(disparity, np.ndarray) and disparity.dtype.kind != "f":
        remedy = ""
        if disparity.dtype == np.int16:
            remedy = ", divide what cv2.StereoSGBM or StereoBM returns by 16.0"
        raise MatcherFailedError(
            f"returned an array of {disparity.dtype}: expected float32 disparities{remedy}",
            "wrong-type",
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
    for cause in _causes(error):
        # The dynamic loader reports a lack of memory as an ImportError.
        unmapped = "failed to map segment" in str(cause)
        if (
            isinstance(cause, MemoryError)
            or getattr(cause, "errno", None) == errno.ENOMEM
            or (isinstance(cause, ImportError) and unmapped)
        ):
            message = f"{prefix}ran out of memory: {cause}".rstrip(": ")
            return MethodError("memory", message)
    message = f"{prefix}{type(error).__name__}: {error}"
    return MethodError("crash", message, _last_frames(error))


def _last_frames(error: BaseException) -> tuple[str, ...]:
    """The last calls of an exception's traceback that are not of twinlens, one line each, the innermost last."""
    frames = [
        frame
        for frame in traceback.extract_tb(error.__traceback__)
        if not Path(frame.filename).is_relative_to(_PACKAGE)
    ]
    return tuple(_frame_line(frame)[:_LONGEST_LINE] for frame in frames[-_FRAMES:])


def _frame_line(frame: traceback.FrameSummary) -> str:
    """`file:line in function: code`, with the path below the current folder; boards name no other folders."""
    path = Path(frame.filename)
    is_below = path.is_relative_to(Path.cwd())
    path = path.relative_to(Path.cwd()) if is_below else Path(path.name)
    return f"{path}:{frame.lineno} in {frame.name}: {frame.line}"


def _causes(error: BaseException) -> Iterator[BaseException]:
    """The exception, its cause, the cause of that one, and so on."""
    seen: list[BaseException] = []
    cause: BaseException | None = error
    while cause is not None and cause not in seen:
        yield cause
        seen.append(cause)
        cause = cause.__cause__ or cause.__context__


_load = functools.cache(pickle.loads)
"""In the worker: the method of a pickle, always the same object, so that what it has compiled or loaded is kept."""


def _call_in_worker(
    function: Callable[..., Any], pickled: bytes, *arguments: Any
) -> Any:
    try:
        method = _load(pickled)
    except Exception as error:
        raise _method_error(error, "cannot be loaded in a worker process: ") from error
    return function(method, *arguments)
