"""One call of somebody's matcher, timed and looked at: what it raises and what it wrongly answers becomes a `Failure`.

`InProcess` calls it right here: nothing is copied, but a hang hangs and a crash of compiled code ends the program. For
strangers there is `sandbox`.
"""

import contextlib
import errno
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from twinlens.errors import TwinlensError
from twinlens.matching.external import WrongAnswerError
from twinlens.scoring.board import Failure

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


def call(method: Method, left: Image, right: Image, search: Search) -> Answer:
    """One timed call; whatever it raises becomes a MethodError."""
    start = time.perf_counter()
    try:
        found = method(left, right, **search)
    except TimeoutError as error:
        raise MethodError("time-limit", str(error)) from error
    except WrongAnswerError as error:
        raise MethodError(error.kind, str(error)) from error
    except (Exception, SystemExit) as error:
        raise failed(error) from error
    return Answer(checked(found, left.shape[:2]), time.perf_counter() - start)


def lacks(method: Any) -> str | None:
    """Why `method` can run on no sample, by its own `check_parts` if it has one; None where nothing speaks against it.

    Only what twinlens itself refuses counts, and no lack of memory: the rest is for the measured call to meet.
    """
    try:
        getattr(method, "check_parts", bool)()
    except TwinlensError as error:
        return None if failed(error).failure.kind == "memory" else str(error)
    except (Exception, SystemExit):
        return None
    return None


def failed(error: BaseException, doing: str = "") -> MethodError:
    """What an exception means: memory where the lack of it is the cause, however it was wrapped, else a crash."""
    hunger = next((cause for cause in _causes(error) if _is_hunger(cause)), None)
    if hunger is not None:
        return MethodError("memory", f"{doing}asked for more memory than there is: {hunger}".rstrip(": "))
    return MethodError("crash", f"{doing}{type(error).__name__}: {error}")


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        yield error
        error = error.__cause__ or error.__context__


def _is_hunger(error: BaseException) -> bool:
    """Whether this says that memory ran out; the dynamic loader says so in words alone."""
    if isinstance(error, OSError) and error.errno == errno.ENOMEM:
        return True
    return isinstance(error, MemoryError) or (isinstance(error, ImportError) and "failed to map segment" in str(error))


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

    def lacks(self, method: Any) -> str | None:
        """See `lacks`."""
        return lacks(method)

    def warm_up(self, method: Method, left: Image, right: Image, search: Search) -> None:
        """See `warm_up`; once for each method and ndisp."""
        key = method.name, search["ndisp"]
        if key not in self._warm:
            self._warm.add(key)
            warm_up(method, left, right, search)

    def call(self, method: Method, left: Image, right: Image, search: Search) -> Answer:
        """See `call`."""
        return call(method, left, right, search)
