"""Calling somebody's matcher so that whatever it does, it does alone: exceptions, dead processes, hangs, wrong answers.

`InProcess` calls it right here: nothing is copied, but a hang hangs and a crash of compiled code ends the program.
`Child` calls it in one spawned process that is kept between calls (so that compiled code stays compiled) and killed at
the time limit: compiled code cannot be interrupted in any gentler way. Methods must then be picklable, and a script
that asks for it must guard its start with `if __name__ == "__main__":`, as everywhere with spawned processes.
"""

import contextlib
import multiprocessing
import pickle
import time
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from twinlens.errors import InputError
from twinlens.scoring.board import Failure

START_LIMIT_S = 60.0
"""How long a fresh process may take to import what it needs."""
WARM_UP_ROWS = 32

Image = NDArray[Any]


class Method(Protocol):
    """A matcher: (left, right) uint8 images (H, W[, 3]) -> float32 disparity (H, W) in pixels, +inf unknown."""

    @property
    def name(self) -> str:
        """What the board calls it."""
        ...

    def __call__(self, left: Image, right: Image, *, ndisp: int) -> Image:
        """Match; `ndisp` is the number of disparities to search, 0 to ndisp - 1 or a little more."""
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


def call(method: Method, left: Image, right: Image, ndisp: int) -> Answer:
    """One timed call; whatever it raises becomes a MethodError."""
    start = time.perf_counter()
    try:
        found = method(left, right, ndisp=ndisp)
    except TimeoutError as error:
        raise MethodError("time-limit", str(error)) from error
    except (Exception, SystemExit) as error:
        raise MethodError("crash", f"{type(error).__name__}: {error}") from error
    return Answer(checked(found, left.shape[:2]), time.perf_counter() - start)


def warm_up(method: Method, left: Image, right: Image, ndisp: int) -> None:
    """A call on the first rows, so that compiling is not in the measured time. What it answers or raises is ignored."""
    with contextlib.suppress(Exception, SystemExit):
        method(left[:WARM_UP_ROWS].copy(), right[:WARM_UP_ROWS].copy(), ndisp=ndisp)


class InProcess:
    """Calls methods here, without a time limit."""

    def __enter__(self) -> "InProcess":
        return self

    def __exit__(self, *_: object) -> None:
        return None

    def warm_up(self, method: Method, left: Image, right: Image, ndisp: int) -> None:
        """See `warm_up`."""
        warm_up(method, left, right, ndisp)

    def call(self, method: Method, left: Image, right: Image, ndisp: int) -> Answer:
        """See `call`."""
        return call(method, left, right, ndisp)


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

    def __enter__(self) -> "Child":
        return self

    def __exit__(self, *_: object) -> None:
        self._kill()

    def warm_up(self, method: Method, left: Image, right: Image, ndisp: int) -> None:
        """As the function, in the child; a hang or a dead process is left for the measured call to meet."""
        with contextlib.suppress(MethodError):
            self._ask(("warm-up", _pickled(method), left, right, ndisp), self.warm_up_limit)

    def call(self, method: Method, left: Image, right: Image, ndisp: int) -> Answer:
        """As the function, in the child."""
        limit = self.limit + float(getattr(method, "grace_s", 0.0))
        answer = self._ask(("call", _pickled(method), left, right, ndisp), limit)
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
            raise MethodError("crash", f"its process died ({self._last_words()})") from None

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

    def _last_words(self) -> str:
        if self._process is None:
            return "before it began"
        self._process.join(timeout=5)
        code = self._process.exitcode
        return f"signal {-code}" if code is not None and code < 0 else f"exit code {code}"

    def _kill(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.join()
        if self._pipe is not None:
            self._pipe.close()
        self._process = self._pipe = None


def _pickled(method: Method) -> bytes:
    try:
        return pickle.dumps(method)
    except Exception as error:
        raise MethodError(
            "crash", f"cannot be sent to another process, run it without a time limit: {error}"
        ) from error


def _serve(pipe: Connection) -> None:
    """The child's whole life: answer questions until the parent is gone. Methods stay loaded between questions."""
    pipe.send("ready")
    loaded: dict[bytes, Method] = {}
    while True:
        try:
            kind, pickled, left, right, ndisp = pipe.recv()
        except (EOFError, OSError):
            return
        pipe.send(_answer(kind, loaded, pickled, left, right, ndisp))


def _answer(kind: str, loaded: dict[bytes, Method], pickled: bytes, left: Image, right: Image, ndisp: int) -> Any:
    try:
        if pickled not in loaded:
            loaded[pickled] = _unpickled(pickled)
        if kind == "warm-up":
            return warm_up(loaded[pickled], left, right, ndisp)
        found = call(loaded[pickled], left, right, ndisp)
        return found.disp, found.seconds
    except MethodError as error:
        return error.failure


def _unpickled(pickled: bytes) -> Method:
    try:
        method: Method = pickle.loads(pickled)
    except Exception as error:
        raise MethodError("crash", f"cannot be loaded in another process: {type(error).__name__}: {error}") from error
    return method
