"""Calling somebody's matcher so that whatever it does, it does alone: dead processes, hangs, hunger, endless talk.

`Child` calls it in one spawned process that is kept between calls (so that compiled code stays compiled) and killed at
the time limit: compiled code cannot be interrupted in any gentler way. Python code is told first (SIGTERM), so that it
ends the programs it runs and removes its files; then everything in the child's process group is killed. What survives
is only what a hanging compiled function started in a session of its own. What methods print there goes nowhere. If
memory runs out, the kernel is told to end the child and not us; with a memory limit it never comes to that. Methods
must be picklable, and a script that asks for a child must guard its start with `if __name__ == "__main__":`, as
everywhere with spawned processes.
"""

import contextlib
import multiprocessing
import os
import pickle
import re
import signal
import time
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, NoReturn

from twinlens.errors import InputError
from twinlens.scoring.board import Failure
from twinlens.scoring.calls import Answer, Image, Method, MethodError, Search, call, failed, lacks, warm_up

START_LIMIT_S = 60.0
"""How long a fresh process may take to import what it needs."""
DYING_S = 5.0
"""How long a child that closed its pipe may take to be dead, and have an exit code."""
LONGEST_LIMIT_S = 1e6
"""Of a call: eleven days, and less than the operating system's clocks can wait for."""
HUNGRY = 122
"""The exit code of a child that memory failed where it can say no more: between two calls, or on the way to one."""
END_S = 2.0
"""How long a child may take to end its own programs and remove its files, before it is killed."""


class _EndedError(BaseException):
    """The child is told to end: not an Exception, so that no method and no net around it takes it for its own."""


class Child:
    """Calls methods in a spawned process: `limit` seconds a call, `warm_up_limit` for the compiling one before it.

    A method that keeps the limit itself, and has things of its own to end then, has `grace_s` seconds more to do so.
    memory_limit: bytes that the process, and each that it starts, may have for its data; None for no limit.
    """

    def __init__(self, limit: float, warm_up_limit: float, memory_limit: int | None = None) -> None:
        if not (0 < limit <= LONGEST_LIMIT_S and 0 < warm_up_limit <= LONGEST_LIMIT_S):
            raise InputError(
                f"time limits are {limit} and {warm_up_limit} s: expected more than 0, at most {LONGEST_LIMIT_S:g}"
            )
        if memory_limit is not None and not memory_limit > 0:
            raise InputError(f"memory_limit is {memory_limit} bytes: expected more than 0")
        self.limit, self.warm_up_limit, self.memory_limit = limit, warm_up_limit, memory_limit
        self._process: BaseProcess | None = None
        self._pipe: Connection | None = None
        self._warm: set[tuple[str, int]] = set()
        self._first_s: dict[str, float] = {}
        self._given_up: set[str] = set()

    def __enter__(self) -> "Child":
        return self

    def __exit__(self, *_: object) -> None:
        self._kill()

    def lacks(self, method: Any) -> str | None:
        """As the function, in the child: it imports a stranger's modules. A hang or a dead process tells nothing."""
        if not hasattr(method, "check_parts"):
            return None
        try:
            found: str | None = self._ask(("lacks", _pickled(method), None, None, {}), self.warm_up_limit)
        except MethodError:
            return None
        return found if isinstance(found, str) else None

    def warm_up(self, method: Method, left: Image, right: Image, search: Search) -> None:
        """As the function, in the child, once for each ndisp in every process: a fresh one has compiled nothing.

        A hang or a dead process is left for the measured call to meet. A method is not warmed up again that hung here,
        or that took more than `limit` and then failed all the same: every pair would pay for it.
        """
        self._started()
        name, ndisp = method.name, search["ndisp"]
        if (name, ndisp) in self._warm or name in self._given_up:
            return
        begun, hung = time.monotonic(), False
        try:
            self._ask(("warm-up", _pickled(method), left, right, search), self.warm_up_limit)
            self._warm.add((name, ndisp))
        except MethodError as error:
            hung = error.failure.kind == "time-limit"
        self._first_s[name] = self.warm_up_limit if hung else time.monotonic() - begun
        if hung:
            self._given_up.add(name)

    def call(self, method: Method, left: Image, right: Image, search: Search) -> Answer:
        """As the function, in the child."""
        limit = self.limit + float(getattr(method, "grace_s", 0.0))
        before = self._before(method.name, search["ndisp"])
        try:
            answer = self._ask(("call", _pickled(method), left, right, search), limit)
        except MethodError as error:
            if self._first_s.get(method.name, 0.0) > self.limit:
                self._given_up.add(method.name)
            if error.failure.kind == "time-limit":
                raise MethodError("time-limit", f"{error}{before}") from error
            raise
        if isinstance(answer, Failure):
            raise MethodError(answer.kind, answer.message)
        return Answer(*answer)

    def _before(self, name: str, ndisp: int) -> str:
        """What a reader of a time limit needs to know of the call before: it took time too, and was not counted."""
        took = self._first_s.get(name)
        if took is None:
            return ""
        if (name, ndisp) in self._warm:
            return f", after {took:.3g} s for a first, uncounted call"
        hung = took >= self.warm_up_limit
        return f"; a first, uncounted call {'gave none in' if hung else 'took'} {took:.3g} s, and is not made again"

    def _ask(self, question: tuple[Any, ...], limit: float) -> Any:
        pipe = self._started()
        try:
            pipe.send(question)
            if not pipe.poll(limit):
                self._kill()
                raise MethodError("time-limit", f"no answer within {limit:g} s")
            return pipe.recv()
        except (EOFError, OSError):
            raise _death(self._kill(patience=DYING_S)) from None

    def _started(self) -> Connection:
        if self._pipe is not None and self._process is not None and self._process.is_alive():
            return self._pipe
        self._kill()
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, self.memory_limit), daemon=True)
        self._process.start()
        theirs.close()
        self._greet(self._pipe)
        return self._pipe

    def _greet(self, pipe: Connection) -> None:
        """Wait for the child's first word: a child that dies before it has a main script that cannot be spawned."""
        word = None
        with contextlib.suppress(EOFError, OSError):
            word = pipe.recv() if pipe.poll(START_LIMIT_S) else None
        if word == "ready":
            return
        code = self._kill(patience=DYING_S if word is None else 0.0)
        if isinstance(word, Failure):
            raise MethodError(word.kind, word.message)
        if code == HUNGRY:
            raise _death(code)
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


def _death(code: int | None) -> MethodError:
    """Why a child that said nothing is dead."""
    if code == HUNGRY:
        return MethodError("memory", "its process had no memory left to be asked with")
    return MethodError("crash", f"its process died ({_ending(code)})")


def _ending(code: int | None) -> str:
    """How a process ended, in words.

    >>> _ending(3), _ending(-11), _ending(-9)
    ('exit code 3', 'signal 11, SIGSEGV', 'signal 9, SIGKILL; it may have been out of memory')
    """
    if code is None or code >= 0:
        return f"exit code {code}"
    with contextlib.suppress(ValueError):
        name = signal.Signals(-code).name
        return f"signal {-code}, {name}" + ("; it may have been out of memory" if name == "SIGKILL" else "")
    return f"signal {-code}"


def _serve(pipe: Connection, memory_limit: int | None) -> None:
    """The child's whole life: answer questions until the parent is gone. Methods stay loaded between questions."""
    if hasattr(os, "setsid"):  # a group of its own, so that it can be killed with all that it starts
        os.setsid()
    _be_quiet()
    held = _held()
    if memory_limit is not None and held > memory_limit:
        needs = f"a process needs {held / 2**30:.2f} GiB before the first match"
        pipe.send(Failure("memory", f"{needs}; the limit is {memory_limit / 2**30:.2g} GiB"))
        return
    _be_modest(memory_limit)
    signal.signal(signal.SIGTERM, _end)
    try:
        _converse(pipe)
    except MemoryError:
        os._exit(HUNGRY)


def _converse(pipe: Connection) -> None:
    loaded: dict[bytes, Method] = {}
    with contextlib.suppress(_EndedError, EOFError, OSError):
        pipe.send("ready")
        while True:
            kind, pickled, left, right, search = pipe.recv()
            pipe.send(_answer(kind, loaded, pickled, left, right, search))


def _held() -> int:
    """Bytes of data that this process has already, as a limit counts them; 0 where the system does not say."""
    with contextlib.suppress(OSError):  # Linux alone knows this file
        found = re.search(r"^VmData:\s*(\d+) kB", Path("/proc/self/status").read_text(), re.MULTILINE)
        return int(found[1]) * 1024 if found else 0
    return 0


def _be_quiet() -> None:
    """What a method prints, ten gigabytes or one line between the lines of our JSON, goes nowhere."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(nowhere, stream)
    os.close(nowhere)


def _be_modest(memory_limit: int | None) -> None:
    """Be the first to end when the machine's memory does; and where there is a limit, get no more than that."""
    with contextlib.suppress(OSError):  # Linux alone knows this file
        Path("/proc/self/oom_score_adj").write_text("1000")
    if memory_limit is not None:
        import resource

        hard = resource.getrlimit(resource.RLIMIT_DATA)[1]
        soft = memory_limit if hard == resource.RLIM_INFINITY else min(memory_limit, hard)
        resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))


def _end(*_: object) -> NoReturn:
    raise _EndedError


def _answer(kind: str, loaded: dict[bytes, Method], pickled: bytes, left: Image, right: Image, search: Search) -> Any:
    try:
        if pickled not in loaded:
            loaded[pickled] = _unpickled(pickled)
        if kind == "lacks":
            return lacks(loaded[pickled])
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
        raise failed(error, "cannot be loaded in another process: ") from error
    return method
