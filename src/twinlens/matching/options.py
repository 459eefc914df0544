"""What all matchers share: the contract of `match`, the search range, checks of options, and limits by image size."""

import importlib
from dataclasses import dataclass, replace
from typing import Annotated, Any, Protocol, Self

from twinlens.errors import InputError, MissingExtraError, check_int
from twinlens.matching.images import Confidence, Disparity

DEFAULT_DISPARITIES = 64
LARGEST_DEFAULT_WINDOW = 35
"""The largest default of a window option, over all methods."""
WINDOW_OPTIONS = ("block_size", "census_window", "median")


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


def match_with_confidence(
    matcher: Any, left: Any, right: Any, **search: Any
) -> tuple[Any, Any]:
    """(disparity, confidence) that the matcher returns, not checked; None if it computes no confidence."""
    return as_pair(
        getattr(matcher, "match_with_confidence", matcher.match)(left, right, **search)
    )


def match_alone(matcher: Any, left: Any, right: Any, **search: Any) -> tuple[Any, Any]:
    """As `match_with_confidence`, but a matcher with an own `match_with_confidence` computes no confidence."""
    return as_pair(matcher.match(left, right, **search))


def as_pair(result: Any) -> tuple[Any, Any]:
    """A pair (disparity, confidence) unchanged, a single map with the confidence None."""
    return result if isinstance(result, tuple) and len(result) == 2 else (result, None)


def import_extra(module: str, extra: str) -> Any:
    """The module of an optional package. Raises MissingExtraError, with the extra that installs it."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise MissingExtraError(
            f"{module} is not installed; pip install 'twinlens[{extra}]'"
        ) from None


@dataclass(frozen=True, kw_only=True)
class RangeMatcher:
    """Base of the matchers with a search range among their options, which are frozen dataclasses."""

    num_disparities: Annotated[int, "Number of disparities to search."] = (
        DEFAULT_DISPARITIES
    )
    min_disparity: Annotated[
        int,
        "Smallest disparity to search, in pixels: u_left - u_right. May be negative.",
    ] = 0

    def __post_init__(self) -> None:
        check_int("num_disparities", self.num_disparities, 1)
        check_int("min_disparity", self.min_disparity)

    def match(
        self,
        left: Any,
        right: Any,
        *,
        num_disparities: int | None = None,
        min_disparity: int | None = None,
    ) -> Disparity:
        """See `matching.Matcher.match`; the disparity alone, without computing a confidence."""
        matcher = self._searching(num_disparities, min_disparity)._without_confidence()
        disparity: Disparity = as_pair(matcher._match(left, right))[0]
        return disparity

    def match_with_confidence(
        self,
        left: Any,
        right: Any,
        *,
        num_disparities: int | None = None,
        min_disparity: int | None = None,
    ) -> tuple[Disparity, Confidence | None]:
        """The disparity, and the confidence if the matcher computes one; see `matching.Matcher.match`."""
        return as_pair(
            self._searching(num_disparities, min_disparity)._match(left, right)
        )

    def _searching(
        self, num_disparities: int | None, min_disparity: int | None
    ) -> Self:
        given = {"num_disparities": num_disparities, "min_disparity": min_disparity}
        return self.replace(
            **{name: value for name, value in given.items() if value is not None}
        )

    def _without_confidence(self) -> Self:
        return self

    def _match(
        self, left: Any, right: Any
    ) -> Disparity | tuple[Disparity, Confidence | None]:
        raise NotImplementedError

    def replace(self, **changes: Any) -> Self:
        """The same matcher with some options changed, and checked."""
        return replace(self, **changes) if changes else self


def check_block_size(name: str, value: Any, least: int = 1) -> None:
    """InputError unless it is the side of a window centred on a pixel: an odd whole number >= least."""
    check_int(name, value, least)
    if value % 2 == 0:
        raise InputError(
            f"{name} is {value}; it must be odd: use {value - 1} or {value + 1}"
        )


def check_image_size(matcher: Any, size: tuple[int, ...]) -> None:
    """Refuse search ranges and windows that are larger than images of `size` (H, W) can use.

    Two pixels of a row of W are at most W - 1 apart, so there are 2 W - 1 disparities; a window with a side of
    2 max(H, W) - 1 covers the whole image at every pixel. Defaults are always allowed. Raises InputError.
    """
    height, width = size
    disparities = (
        f"an image {width} pixels wide has disparities from {1 - width} to {width - 1}"
    )
    count, first = (
        getattr(matcher, "num_disparities", 1),
        getattr(matcher, "min_disparity", 0),
    )
    if count > max(2 * width - 1, DEFAULT_DISPARITIES):
        raise InputError(
            f"num_disparities is {count}: {disparities}, {2 * width - 1} in all"
        )
    if not -width < first < width:
        raise InputError(f"min_disparity is {first}: {disparities}")
    largest = max(2 * max(size) - 1, LARGEST_DEFAULT_WINDOW)
    for option in WINDOW_OPTIONS:
        window = getattr(matcher, option, 0)
        if window > largest:
            covered = f"a window of {largest} covers all of an image of {width} x {height} at every pixel"
            raise InputError(f"{option} is {window}: {covered}")
