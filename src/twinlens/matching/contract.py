"""What every matcher takes and returns, and the checks that all matchers share. No algorithm is in this module.

A matcher of twinlens is a `BaseMatcher`, whose `compute` returns an `Answer`. A matcher of a user is anything that
satisfies `Matcher`; `answer_of` calls either kind, and `checked_answer` validates what user code returned.
"""

import abc
import functools
import hashlib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Protocol, Self

import numpy as np

from twinlens.errors import InputError
from twinlens.matching.images import Confidence, Disparity
from twinlens.settings import Setting, Settings

DEFAULT_DISPARITIES = 64
LARGEST_DEFAULT_WINDOW = 35
"""The largest default of a window option, over all methods."""
WINDOW_OPTIONS = ("block_size", "census_window", "median")
HASH_DIGITS = 16  # hexadecimal digits kept of a file's SHA-256


class MatcherFailedError(InputError):
    """A function, a program or a model failed while it ran, or did not return a disparity map.

    kind: crash, time-limit, wrong-type, wrong-shape or not-a-number. An exception of a function is the cause of this
    one.
    """

    exit_code = 1

    def __init__(self, message: str, kind: str = "crash") -> None:
        super().__init__(message)
        self.kind = kind

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (str(self), self.kind)  # worker processes pickle it


class Answer(NamedTuple):
    """What a matcher computes for a pair of images.

    disparity: (H, W) float32, u_left - u_right in pixels, +inf where unknown. confidence: (H, W) float32, higher where
    the disparity is more probably right; None from a matcher that computes none.
    """

    disparity: Disparity
    confidence: Confidence | None = None


class Matcher(Protocol):
    """A stereo matcher. All methods of `METHODS` make one, and `match` and `scoring.run_benchmark` accept any."""

    def match(
        self, left: Any, right: Any, *, num_disparities: int, min_disparity: int
    ) -> Disparity | tuple[Disparity, Confidence]:
        """Match two rectified images.

        left, right: (H, W) or (H, W, 3), of one size and dtype: uint8, uint16 or float32. The search covers
        min_disparity <= d < min_disparity + num_disparities; twinlens's matchers have defaults for both.
        Returns the left image's disparity u_left - u_right in pixels, (H, W) float32; +inf where unknown. It may also
        return (disparity, confidence), with the confidence (H, W) float32 higher where the disparity is more probably
        right.
        Raises InputError for images that differ in size or dtype, or cannot be matched.
        """
        ...


class BaseMatcher(abc.ABC):
    """Base of twinlens's own matchers: a subclass implements `compute`, and `searching` if it has a search range."""

    @abc.abstractmethod
    def compute(self, left: Any, right: Any) -> Answer:
        """The answer for two images, with the confidence if the matcher has one."""

    def searching(
        self,
        num_disparities: int | None,
        min_disparity: int | None,
    ) -> "BaseMatcher":
        """The matcher with this search range, None for its own; itself if it has no range."""
        return self

    def without_confidence(self) -> "BaseMatcher":
        """The matcher that computes the same disparities and, where that saves time, no confidence."""
        return self

    @property
    def content(self) -> str:
        """Hashes of the files that the matcher consists of; "" if twinlens's version determines its results."""
        return ""

    def check_parts(self) -> None:  # noqa: B027
        """Raise a TwinlensError if a file, function or package that the matcher needs is missing."""

    def match(
        self,
        left: Any,
        right: Any,
        *,
        num_disparities: int | None = None,
        min_disparity: int | None = None,
    ) -> Disparity:
        """See `matching.Matcher.match`; the disparity alone, without computing a confidence."""
        matcher = self.searching(num_disparities, min_disparity)
        return matcher.without_confidence().compute(left, right).disparity

    def match_with_confidence(
        self,
        left: Any,
        right: Any,
        *,
        num_disparities: int | None = None,
        min_disparity: int | None = None,
    ) -> Answer:
        """The disparity, and the confidence if the matcher computes one; see `matching.Matcher.match`."""
        return self.searching(num_disparities, min_disparity).compute(left, right)


@dataclass(frozen=True, kw_only=True)
class RangeMatcher(Settings, BaseMatcher, noun="option"):
    """Base of the matchers with a search range among their options, which are frozen dataclasses."""

    num_disparities: Annotated[
        int, Setting("Number of disparities to search.", least=1)
    ] = DEFAULT_DISPARITIES
    min_disparity: Annotated[
        int,
        Setting(
            "Smallest disparity to search, in pixels: u_left - u_right. May be negative."
        ),
    ] = 0

    def searching(self, num_disparities: int | None, min_disparity: int | None) -> Self:
        changes = {}
        if num_disparities is not None:
            changes["num_disparities"] = num_disparities
        if min_disparity is not None:
            changes["min_disparity"] = min_disparity
        return self.replace(**changes)


def answer_of(matcher: Any, left: Any, right: Any, **search: int) -> Any:
    """What a matcher of twinlens or of a user returns, with its confidence; see `checked_answer`."""
    if isinstance(matcher, BaseMatcher):
        return matcher.searching(**search).compute(left, right)
    return matcher.match(left, right, **search)


def checked_answer(result: Any, shape: tuple[int, ...], name: str) -> Answer:
    """The answer of `name`, which returned a map or a pair (disparity, confidence), as float32 of this shape (H, W).

    Raises MatcherFailedError for maps of another type or shape, for NaN, and for disparities of -inf; unknown ones are
    +inf.
    """
    disparity, confidence = unchecked_pair(result)
    checked = _checked_disparity(disparity, shape, name)
    if confidence is None:
        return Answer(checked)
    return Answer(checked, _checked_confidence(confidence, shape, name))


def unchecked_pair(result: Any) -> tuple[Any, Any]:
    """(disparity, confidence) of what a matcher returned, a map or such a pair; without a confidence None."""
    is_pair = isinstance(result, tuple) and len(result) == 2
    return result if is_pair else (result, None)


def _checked_disparity(result: Any, shape: tuple[int, ...], name: str) -> Disparity:
    try:
        # NumPy would convert None to NaN.
        values = np.asarray("None" if result is None else result)
        if values.dtype.kind == "c":
            raise TypeError
        disparity = values.astype(np.float32, copy=False)
    except (TypeError, ValueError):
        message = (
            f"{name} returned {type(result).__name__}, not an array of real disparities"
        )
        raise MatcherFailedError(message, "wrong-type") from None
    if disparity.shape != shape:
        message = f"{name} returned shape {disparity.shape}; the left image has {shape}"
        raise MatcherFailedError(
            message + _shape_hint(disparity.shape, shape), "wrong-shape"
        )
    wrong = np.isnan(disparity) | np.isneginf(disparity)
    if wrong.any():
        y, x = np.argwhere(wrong)[0]
        message = f"{name} returned {disparity[y, x]} at [{y}, {x}]; unknown disparities are +inf"
        raise MatcherFailedError(message, "not-a-number")
    return disparity


def _shape_hint(shape: tuple[int, ...], expected: tuple[int, ...]) -> str:
    """What probably led to the shape of a map, and what to do; empty if it is not clear."""
    if shape == expected[::-1]:
        return ": transpose the map, its axes are [row, column]"
    if len(shape) > 2 and tuple(side for side in shape if side != 1) == expected:
        return ": remove its axes of length 1"
    if len(shape) == 2 and all(shape):
        for factor in (2, 4, 8):
            sizes = zip(shape, expected, strict=True)
            if all(abs(factor * side - whole) < factor for side, whole in sizes):
                return f": enlarge the map to the image's size and multiply its values by {factor}"
    return ""


def _checked_confidence(result: Any, shape: tuple[int, ...], name: str) -> Confidence:
    values = np.asarray(result)
    if values.dtype.kind not in "biuf":
        raise MatcherFailedError(
            f"{name} returned a confidence of {values.dtype}, not real numbers",
            "wrong-type",
        )
    if values.shape != shape:
        raise MatcherFailedError(
            f"{name} returned a confidence of shape {values.shape}; expected {shape}",
            "wrong-shape",
        )
    confidence = values.astype(np.float32, copy=False)
    if np.isnan(confidence).any():
        raise MatcherFailedError(
            f"{name} returned a confidence with NaN", "not-a-number"
        )
    return confidence


def file_hashes(paths: Iterable[Path]) -> str:
    """Comma-separated `name=hash` of the files, sorted by path; `name=absent` for a file that cannot be read.

    A board stores this text, and rescores a network or program whose files have changed.

    >>> file_hashes([Path("no-such-file")]), file_hashes([])
    ('no-such-file=absent', '')
    """
    return ",".join(f"{path.name}={_hash(path)}" for path in sorted(set(paths)))


def _hash(path: Path) -> str:
    try:
        status = path.stat()
        return _cached_hash(path, status.st_mtime_ns, status.st_size)
    except OSError:
        return "absent"


@functools.lru_cache(maxsize=256)
def _cached_hash(path: Path, _written_ns: int, _size: int) -> str:
    """The hash of a file until its time or size changes; a board needs it for every sample."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:HASH_DIGITS]


def check_image_size(matcher: Any, size: tuple[int, ...]) -> None:
    """Refuse search ranges and windows that are larger than images of `size` (H, W) can use.

    Two pixels of a row of W are at most W - 1 apart, so there are 2 W - 1 disparities; a window with a side of
    2 max(H, W) - 1 covers the whole image at every pixel. Defaults are always allowed. Raises InputError.
    """
    height, width = size
    disparities = (
        f"an image {width} pixels wide has disparities from {1 - width} to {width - 1}"
    )
    count = getattr(matcher, "num_disparities", 1)
    if count > max(2 * width - 1, DEFAULT_DISPARITIES):
        raise InputError(
            f"num_disparities is {count}: {disparities}, {2 * width - 1} in all"
        )
    first = getattr(matcher, "min_disparity", 0)
    if not -width < first < width:
        raise InputError(f"min_disparity is {first}: {disparities}")
    largest = max(2 * max(size) - 1, LARGEST_DEFAULT_WINDOW)
    for option in WINDOW_OPTIONS:
        window = getattr(matcher, option, 0)
        if window > largest:
            covered = f"a window of {largest} covers all of an image of {width} x {height} at every pixel"
            raise InputError(f"{option} is {window}: {covered}")
