"""User code as a matcher: Python functions, checks of the maps that user code returns, and hashes of its files."""

import functools
import hashlib
import importlib
import importlib.util
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from twinlens.errors import InputError
from twinlens.matching.images import Disparity
from twinlens.matching.options import MinDisparity, NumDisparities, check_range, with_range

HASH_DIGITS = 16
"""Hexadecimal digits kept of a file's SHA-256: 64 bits."""


class WrongAnswerError(InputError):
    """User code returned something that is no disparity map; kind: wrong-type, wrong-shape or not-a-number."""

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.kind = kind


def checked_result(result: Any, shape: tuple[int, ...], name: str) -> Disparity:
    """The result of `name` as float32 of this (H, W).

    Raises WrongAnswerError for another type or shape, and for NaN and -inf; unknown disparities are +inf.
    """
    disparity = _numbers(result, name)
    if disparity.shape != shape:
        raise WrongAnswerError("wrong-shape", f"{name} returned shape {disparity.shape}; the left image has {shape}")
    wrong = np.isnan(disparity) | np.isneginf(disparity)
    if wrong.any():
        y, x = np.argwhere(wrong)[0]
        raise WrongAnswerError(
            "not-a-number", f"{name} returned {disparity[y, x]} at [{y}, {x}]; unknown disparities are +inf"
        )
    return disparity


def _numbers(result: Any, name: str) -> Disparity:
    try:
        if result is not None:  # NumPy converts None to NaN
            return np.asarray(result, dtype=np.float32)
    except (TypeError, ValueError):
        pass
    raise WrongAnswerError("wrong-type", f"{name} returned {type(result).__name__}, not an array of disparities")


def content_of(paths: Iterable[Path]) -> str:
    """`name=hash` of every file, in the order of names; `name=absent` for a file that cannot be read.

    A board stores this text: if a network or a program changes under the same name, its scores are computed again.

    >>> content_of([Path("no-such-file")]), content_of([])
    ('no-such-file=absent', '')
    """
    return ",".join(f"{path.name}={_hash(path)}" for path in sorted(set(paths)))


def _hash(path: Path) -> str:
    try:
        state = path.stat()
        return _hash_of_state(path, state.st_mtime_ns, state.st_size)
    except OSError:
        return "absent"


@functools.lru_cache(maxsize=256)
def _hash_of_state(path: Path, _written_ns: int, _size: int) -> str:
    """The hash of a file in this state; cached because a board needs it for every sample."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:HASH_DIGITS]


@dataclass(frozen=True)
class PythonFunction:
    """A Python function(left, right, *, num_disparities, min_disparity) that returns disparities (H, W).

    It receives the images unchanged. Its result is checked; see `checked_result`.
    """

    function: Annotated[
        Callable[..., Any] | str,
        "path/to/file.py:name, relative to the current folder, or module:name of an importable module.",
    ] = ""
    num_disparities: NumDisparities = 64
    min_disparity: MinDisparity = 0

    def __post_init__(self) -> None:
        check_range(self.num_disparities, self.min_disparity)
        if isinstance(self.function, str) and not all(self._place):
            raise InputError(f"function is {self.function!r}; write path/to/file.py:name or module:name")

    @property
    def _place(self) -> tuple[str, str]:
        """(file or module, name) of a function given as text."""
        module, _, name = str(self.function).rpartition(":")
        return module, name

    @property
    def content(self) -> str:
        """The hash of the file that defines a function given as text; files that it imports are not seen."""
        if callable(self.function):
            return ""
        module = self._place[0]
        origin = module if module.endswith(".py") else _file_of(module)
        return content_of([Path(origin)] if origin else [])

    def check_parts(self) -> None:
        """InputError if there is no such function. Imports its module."""
        self._found()

    def _found(self) -> Callable[..., Any]:
        return self.function if callable(self.function) else _imported(*self._place)

    def match(
        self, left: Any, right: Any, *, num_disparities: int | None = None, min_disparity: int | None = None
    ) -> Disparity:
        """The function's disparities; see `options.Matcher.match`."""
        task, function = with_range(self, num_disparities, min_disparity), self._found()
        result = function(left, right, num_disparities=task.num_disparities, min_disparity=task.min_disparity)
        return checked_result(result, np.shape(left)[:2], f"function {getattr(function, '__name__', function)!r}")


def _file_of(module: str) -> str | None:
    try:
        found = importlib.util.find_spec(module)
    except Exception:  # it imports the packages above the module, which may raise anything
        return None
    return None if found is None or not found.has_location else found.origin


def _imported(module: str, name: str) -> Callable[..., Any]:
    place = f"{module}:{name}"
    try:
        found: Any = _module_of_file(Path(module)) if module.endswith(".py") else importlib.import_module(module)
        for part in name.split("."):
            found = getattr(found, part)
    except (ImportError, AttributeError, OSError) as problem:
        raise InputError(f"function {place!r} cannot be imported: {problem}") from None
    except SyntaxError as problem:
        raise InputError(f"function {place!r} cannot be imported: its module has a syntax error; {problem}") from None
    if not callable(found):
        raise InputError(f"function {place!r} is {type(found).__name__}, which cannot be called")
    return found  # type: ignore[no-any-return]


def _module_of_file(path: Path) -> Any:
    """The module of a .py file, executed once for each state of the file.

    The file may import modules from its own folder, as a script may.
    """
    state = path.resolve(strict=True)
    return _executed(state, state.stat().st_mtime_ns)


@functools.lru_cache(maxsize=32)
def _executed(path: Path, _written_ns: int) -> Any:
    spec = importlib.util.spec_from_file_location(f"twinlens_method_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise ImportError(f"{path} is not a Python file")
    module = importlib.util.module_from_spec(spec)
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module
