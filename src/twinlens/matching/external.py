"""Any Python function behind the same two words, `match(left, right)`, and the look at what a stranger's code returns.

What comes back is checked: the left image's size, no NaN, no -inf; +inf means unknown.
"""

import importlib
import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from twinlens.errors import InputError
from twinlens.matching.checks import whole
from twinlens.matching.identity import content_of
from twinlens.matching.images import Disparity


class WrongAnswerError(InputError):
    """A stranger's code answered, and not with a disparity map; kind: wrong-type, wrong-shape or not-a-number."""

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.kind = kind


def checked_result(result: Any, shape: tuple[int, ...], name: str) -> Disparity:
    """The result as float32 (H, W), or a WrongAnswerError that says what `name` did wrong."""
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
        if result is not None:  # which numpy takes for one NaN
            return np.asarray(result, dtype=np.float32)
    except (TypeError, ValueError):
        pass
    raise WrongAnswerError("wrong-type", f"{name} returned {type(result).__name__}, not an array of disparities")


@dataclass(frozen=True)
class PythonFunction:
    """A Python function(left, right, num_disparities=..., min_disparity=...) that returns (H, W) disparities.

    function: the function itself, or "module:name". It is given the images as they are.
    """

    function: Callable[..., Any] | str = ""
    num_disparities: int = 64
    min_disparity: int = 0

    def __post_init__(self) -> None:
        whole("num_disparities", self.num_disparities, 1)
        whole("min_disparity", self.min_disparity)
        if isinstance(self.function, str) and ":" not in self.function:
            raise InputError(f"function is {self.function!r}; write module:name")

    @property
    def content(self) -> str:
        """The hash of the file that the function of a "module:name" stands in; what it imports in turn is not seen."""
        origin = None if callable(self.function) else _file_of(self.function.partition(":")[0])
        return content_of([Path(origin)] if origin else [])

    def check_parts(self) -> None:
        """InputError if there is no such function; its module is imported."""
        self._function()

    def _function(self) -> Callable[..., Any]:
        return self.function if callable(self.function) else _imported(self.function)

    def match(self, left: Any, right: Any) -> Disparity:
        """The left image's disparity, (H, W) float32, +inf where unknown."""
        function = self._function()
        result = function(left, right, num_disparities=self.num_disparities, min_disparity=self.min_disparity)
        return checked_result(result, np.shape(left)[:2], f"function {getattr(function, '__name__', function)!r}")


def _file_of(module: str) -> str | None:
    try:
        found = importlib.util.find_spec(module)
    except Exception:  # it runs the packages above the module, and they may do anything
        return None
    return None if found is None or not found.has_location else found.origin


def _imported(place: str) -> Callable[..., Any]:
    module, _, name = place.partition(":")
    try:
        found: Any = importlib.import_module(module)
        for part in name.split("."):
            found = getattr(found, part)
    except (ImportError, AttributeError) as problem:
        raise InputError(f"function {place!r} cannot be imported: {problem}") from None
    except SyntaxError as problem:
        raise InputError(f"function {place!r} cannot be imported: its module is no Python; {problem}") from None
    if not callable(found):
        raise InputError(f"function {place!r} is {type(found).__name__}, which cannot be called")
    return found  # type: ignore[no-any-return]
