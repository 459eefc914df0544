"""What all matchers share: the contract of `match`, the search range, and checks of options."""

import dataclasses
import numbers
from typing import Annotated, Any, Protocol, TypeVar

import numpy as np

from twinlens.errors import InputError
from twinlens.matching.images import Disparity

NumDisparities = Annotated[int, "Number of disparities to search."]
MinDisparity = Annotated[int, "Smallest disparity to search, in pixels: u_left - u_right. May be negative."]
M = TypeVar("M")


class Matcher(Protocol):
    """A stereo matcher. All methods of `METHODS` make one, and any object with this `match` can be scored."""

    def match(
        self, left: Any, right: Any, *, num_disparities: int | None = None, min_disparity: int | None = None
    ) -> Disparity:
        """The left image's disparity, (H, W) float32 in pixels, u_left - u_right; +inf where unknown.

        left, right: rectified images (H, W) or (H, W, 3) of one size and dtype. The search covers
        min_disparity <= d < min_disparity + num_disparities; None: the matcher's own value.
        """
        ...


def with_range(matcher: M, num_disparities: int | None, min_disparity: int | None) -> M:
    """The matcher with another search range; None keeps its own value."""
    given = {"num_disparities": num_disparities, "min_disparity": min_disparity}
    changes = {name: value for name, value in given.items() if value is not None}
    return dataclasses.replace(matcher, **changes) if changes else matcher  # type: ignore[type-var]


def check_range(num_disparities: Any, min_disparity: Any) -> None:
    """InputError unless both are whole numbers and the range is not empty."""
    whole("num_disparities", num_disparities, 1)
    whole("min_disparity", min_disparity)


def whole(name: str, value: Any, least: int | None = None) -> int:
    """A whole number, at least `least`."""
    if isinstance(value, bool) or not isinstance(value, numbers.Integral):
        raise InputError(f"{name} is {value!r}; it must be a whole number")
    if least is not None and value < least:
        raise InputError(f"{name} is {value}; it must be at least {least}")
    return int(value)


def check_block_size(name: str, value: Any) -> int:
    """The side of a window centred on a pixel: a positive odd whole number."""
    side = whole(name, value, 1)
    if side % 2 == 0:
        raise InputError(f"{name} is {side}; it must be odd: use {side - 1} or {side + 1}")
    return side


def amount(name: str, value: Any, *, above: bool = False) -> float:
    """A finite number >= 0, or above 0."""
    if isinstance(value, bool) or not isinstance(value, numbers.Real) or not np.isfinite(float(value)):
        raise InputError(f"{name} is {value!r}; it must be a number")
    if float(value) < 0 or (above and float(value) == 0):
        raise InputError(f"{name} is {value}; it must be {'above 0' if above else '>= 0'}")
    return float(value)
