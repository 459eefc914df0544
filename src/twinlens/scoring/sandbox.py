"""Calling somebody's matcher so that whatever it does, it does alone: exceptions, dead processes, hangs, wrong answers.

`InProcess` calls it right here: nothing is copied, but a hang hangs and a crash of compiled code ends the program.
`Child` calls it in one spawned process that is kept between calls (so that compiled code stays compiled) and killed at
the time limit: compiled code cannot be interrupted in any gentler way. Python code is told first (SIGTERM), so that it
ends the programs it runs and removes its files; then everything in the child's process group is killed. What survives
is only what a hanging compiled function started in a session of its own. Methods must be picklable, and a script that
asks for a child must guard its start with `if __name__ == "__main__":`, as everywhere with spawned processes.
"""

import contextlib
import multiprocessing
import os
import pickle
import signal
import time
from collections.abc import Mapping
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, NoReturn, Protocol

import numpy as np
from numpy.typing import NDArray

from twinlens.errors import InputError
from twinlens.scoring.board import Failure

START_LIMIT_S = 60.0
"""How long a fresh process may take to import what it needs."""
DYING_S = 5.0
"""How long a child that closed its pipe may take to be dead, and have an exit code."""
END_S = 2.0
"""How long a child may take to end its own programs and remove its files, before it is killed."""
WARM_UP_ROWS = 32

Image = NDArray[Any]
Search = Mapping[str, int]
"""The keyword arguments that say where to search: ndisp, and min_disparity where it is not 0."""


class Method(Protocol):
    """A matcher: (left, right) uint8 images (H, W[, 3]) -> float32 disparity (H, W) in pixels, +inf unknown."""

    @property
    def name(self) -> str:
        """What the board calls it."""
        ...

    def __call__(self, left: Image, right: Image, *, ndisp: int) -> Image:
        """Match; `ndisp` is the number of disparities to search, 0 to ndisp - 1 or a little more.

        For a pair that has negative disparities, and for no other, `min_disparity=` is given too: then the search is
        from there to min_disparity + ndisp - 1.
        """
        ...


@dataclass(frozen=True)
class Answer:
    """A checked disparity map and the wall time of its call in seconds."""

    disp: Image
    seconds: float | None


class MethodError(Exception):
    """A method failed on a pair; `failure` says how."""

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.failure = Failure(kind, " ".join(message.split())[:300] or kind)


def checked(found: Any, shape: tuple[int, int]) -> Image:
    """What a method returned, if it is an (H, W) float map without NaN and -inf; MethodError otherwise."""
    if not isinstance(found, np.ndarray) or found.dtype.kind != "f":
        what = f"an array of {found.dtype}" if isinstance(found, np.ndarray) else type(found).__name__
        raise MethodError("wrong-type", f"answered {what}: expected a float32 array of disparities")
    if found.shape != shape:
        raise MethodError("wrong-shape", f"answered shape {found.shape}: expected {shape}")
    wrong = int(np.count_nonzero(np.isnan(found) | np.isneginf(found)))
    if wrong:
        raise MethodError("not-a-number", f"NaN or -inf at {wrong} of {found.size} pixels: unknown is +inf")
    return found.astype(np.float32, copy=False)


class _EndedError(BaseException):
    """The child is told to end: not an Exception, so that no method and no net around it takes it for its own."""


def call(method: Method, left: Image, right: Image, search: Search) -> Answer:
    """One timed call; whatever it raises becomes a MethodError."""
    start = time.perf_counter()
    try:
        found = method(left, right, **search)
    except TimeoutError as error:
        raise MethodError("time-limit", str(error)) from error
    except (Exception, SystemExit) as error:
        raise MethodError("crash", f"{type(error).__name__}: {error}") from error
    return Answer(checked(found, left.shape[:2]), time.perf_counter() - start)


def warm_up(method: Method, left: Image, right: Image, search: Search) -> None:
    """A call on the first rows, so that compiling is not in the measured time. What it answers or raises is ignored."""
    with contextlib.suppress(Exception, SystemExit):
        method(left[:WARM_UP_ROWS].copy(), right[:WARM_UP_ROWS].copy(), **search)


class InProcess:
    """Calls methods here, without a time limit."""

    def __init__(self) -> None:
        self._warm: set[tuple[str, int]] = set()

    def __enter__(self) -> "InProcess":
        return self

    def __exit__(self, *_: object) -> None:
        return None

    def warm_up(self, method: Method, left: Image, right: Image, search: Search) -> None:
        """See `warm_up`; once for each method and ndisp."""
        key = method.name, search["ndisp"]
        if key not in self._warm:
            self._warm.add(key)
            warm_up(method, left, right, search)

    def call(self, method: Method, left: Image, right: Image, search: Search) -> Answer:
        """See `call`."""
        return call(method, left, right, search)


class Child:
    """Calls methods in a spawned process: `limit` seconds a call, `warm_up_limit` for the compiling one before it.

    A method that keeps the limit itself, and has things of its own to end then, has `grace_s` seconds more to do so.
    """

    def __init__(self, limit: float, warm_up_limit: float) -> None:
        if not (limit > 0 and warm_up_limit > 0):
            raise InputError(f"time limits are {limit} and {warm_up_limit} s: expected more than 0")
        self.limit, self.warm_up_limit = limit, warm_up_limit
        self._process: BaseProcess | None = None
        self._pipe: Connection | None = None
        self._warm: set[tuple[str, int]] = set()
        self._hung: set[str] = set()

    def __enter__(self) -> "Child":
        return self

    def __exit__(self, *_: object) -> None:
        self._kill()

    def warm_up(self, method: Method, left: Image, right: Image, search: Search) -> None:
        """As the function, in the child, once for each ndisp in every process: a fresh one has compiled nothing.

        A hang or a dead process is left for the measured call to meet; what hung here once is not warmed up again.
        """
        self._started()
        key = method.name, search["ndisp"]
        if key in self._warm or method.name in self._hung:
            return
        try:
            self._ask(("warm-up", _pickled(method), left, right, search), self.warm_up_limit)
            self._warm.add(key)
        except MethodError as error:
            if error.failure.kind == "time-limit":
                self._hung.add(method.name)

    def call(self, method: Method, left: Image, right: Image, search: Search) -> Answer:
        """As the function, in the child."""
        limit = self.limit + float(getattr(method, "grace_s", 0.0))
        answer = self._ask(("call", _pickled(method), left, right, search), limit)
        if isinstance(answer, Failure):
            raise MethodError(answer.kind, answer.message)
        return Answer(*answer)

    def _ask(self, question: tuple[Any, ...], limit: float) -> Any:
        pipe = self._started()
        try:
            pipe.send(question)
            if not pipe.poll(limit):
                self._kill()
                raise MethodError("time-limit", f"no answer within {limit:g} s")
            return pipe.recv()
        except (EOFError, OSError):
            code = self._kill(patience=DYING_S)
            said = f"signal {-code}" if code is not None and code < 0 else f"exit code {code}"
            raise MethodError("crash", f"its process died ({said})") from None

    def _started(self) -> Connection:
        if self._pipe is not None and self._process is not None and self._process.is_alive():
            return self._pipe
        self._kill()
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs,), daemon=True)
        self._process.start()
        theirs.close()
        self._greet(self._pipe)
        return self._pipe

    def _greet(self, pipe: Connection) -> None:
        """Wait for the child's first word: a child that dies before it has a main script that cannot be spawned."""
        try:
            if pipe.poll(START_LIMIT_S) and pipe.recv() == "ready":
                return
        except (EOFError, OSError):
            pass
        self._kill()
        raise InputError('a time limit needs a second process: guard the script with `if __name__ == "__main__":`')

    def _kill(self, patience: float = 0.0) -> int | None:
        """End the process and all that it started, gently for `END_S`; its exit code. It may be dying by itself."""
        process, pipe = self._process, self._pipe
        self._process = self._pipe = None
        self._warm.clear()
        if pipe is not None:
            pipe.close()
        if process is None or process.pid is None:
            return None
        if not wait([process.sentinel], patience):
            process.terminate()
            wait([process.sentinel], END_S)
        # Before `join`: until then the number is the child's own, and no other group can have it.
        if hasattr(os, "killpg"):
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(process.pid, signal.SIGKILL)
        process.kill()
        process.join()
        return process.exitcode


def _pickled(method: Method) -> bytes:
    try:
        return pickle.dumps(method)
    except Exception as error:
        raise MethodError(
            "crash", f"cannot be sent to another process, run it without a time limit: {error}"
        ) from error


def _serve(pipe: Connection) -> None:
    """The child's whole life: answer questions until the parent is gone. Methods stay loaded between questions."""
    if hasattr(os, "setsid"):  # a group of its own, so that it can be killed with all that it starts
        os.setsid()
    signal.signal(signal.SIGTERM, _end)
    loaded: dict[bytes, Method] = {}
    with contextlib.suppress(_EndedError, EOFError, OSError):
        pipe.send("ready")
        while True:
            kind, pickled, left, right, search = pipe.recv()
            pipe.send(_answer(kind, loaded, pickled, left, right, search))


def _end(*_: object) -> NoReturn:
    raise _EndedError


def _answer(kind: str, loaded: dict[bytes, Method], pickled: bytes, left: Image, right: Image, search: Search) -> Any:
    try:
        if pickled not in loaded:
            loaded[pickled] = _unpickled(pickled)
        if kind == "warm-up":
            return warm_up(loaded[pickled], left, right, search)
        found = call(loaded[pickled], left, right, search)
        return found.disp, found.seconds
    except MethodError as error:
        return error.failure


def _unpickled(pickled: bytes) -> Method:
    try:
        method: Method = pickle.loads(pickled)
    except Exception as error:
        raise MethodError("crash", f"cannot be loaded in another process: {type(error).__name__}: {error}") from error
    return method
