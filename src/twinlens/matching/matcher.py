"""`StereoMatcher`: a classical stereo matcher as one frozen description, and what runs it."""

import dataclasses
import numbers
from dataclasses import dataclass
from typing import Any

import numpy as np

from twinlens.errors import InputError, unknown

from .box import BoxMatch, cpu_count
from .costs import COSTS
from .images import Disparity, Image, pair
from .refine import consistent

SUBPIXEL = ("auto", "none", "parabola", "v")


def _whole(name: str, value: Any, least: int | None = None) -> int:
    if isinstance(value, bool) or not isinstance(value, numbers.Integral):
        raise InputError(f"{name} is {value!r}; it must be a whole number")
    if least is not None and value < least:
        raise InputError(f"{name} is {value}; it must be at least {least}")
    return int(value)


def check_block_size(name: str, value: Any) -> int:
    """The side of a window centred on a pixel: a positive odd whole number."""
    side = _whole(name, value, 1)
    if side % 2 == 0:
        raise InputError(f"{name} is {side}; a window centred on a pixel is odd: use {side - 1} or {side + 1}")
    return side


@dataclass(frozen=True)
class StereoMatcher:
    """A stereo matcher: what is compared, over which window, how the winner is chosen and refined.

    cost: a name of `COSTS`. block_size: side of the square window, odd, in pixels. The search covers the disparities
    min_disparity <= d < min_disparity + num_disparities, in pixels, d = u_left - u_right.
    subpixel: "auto" (the fit that suits the cost), "v", "parabola" or "none".
    lr_check: None, or the most (in pixels) by which left and right disparity may differ before both become unknown.
    threads: None for all processors; the answer is the same bytes for any number of them.

    Borders: images are continued by their edge pixels, so every window is whole and every pixel gets an answer, unless
    none of its partners u - d lies inside the right image: it is then unknown, +inf. Of equal costs the smallest
    disparity wins. A winner at the end of its pixel's range gets no sub-pixel fit.

    >>> StereoMatcher(cost="sad", block_size=7).num_disparities
    64
    """

    cost: str = "zncc"
    block_size: int = 9
    num_disparities: int = 64
    min_disparity: int = 0
    subpixel: str = "auto"
    lr_check: float | None = None
    threads: int | None = None

    def __post_init__(self) -> None:
        if self.cost not in COSTS:
            raise unknown("cost", self.cost, COSTS)
        if self.subpixel not in SUBPIXEL:
            raise unknown("subpixel fit", self.subpixel, SUBPIXEL)
        check_block_size("block_size", self.block_size)
        _whole("num_disparities", self.num_disparities, 1)
        _whole("min_disparity", self.min_disparity)
        if self.threads is not None:
            _whole("threads", self.threads, 1)
        if self.lr_check is not None and not self.lr_check >= 0:
            raise InputError(f"lr_check is {self.lr_check!r}; it must be None or a number of pixels >= 0")

    def replace(self, **changes: Any) -> "StereoMatcher":
        """The same matcher with some fields changed, checked anew."""
        return dataclasses.replace(self, **changes)

    def match(self, left: Any, right: Any) -> Disparity:
        """The left image's disparity, (H, W) float32 in pixels, +inf where unknown."""
        images = self._checked(left, right)
        disparity = self._search(*images)
        if self.lr_check is None:
            return disparity
        return consistent(disparity, self._search_right(*images), self.lr_check)

    def match_pair(self, left: Any, right: Any) -> tuple[Disparity, Disparity]:
        """The disparities of the left and of the right image, each (H, W); a point has the same sign in both."""
        images = self._checked(left, right)
        ours, theirs = self._search(*images), self._search_right(*images)
        if self.lr_check is None:
            return ours, theirs
        mirrored = consistent(theirs[:, ::-1], ours[:, ::-1], self.lr_check)
        return consistent(ours, theirs, self.lr_check), np.ascontiguousarray(mirrored[:, ::-1])

    def _checked(self, left: Any, right: Any) -> tuple[Image, Image]:
        images = pair(left, right)
        lowest = min(float(image.min()) for image in images)
        if self.cost == "jaccard" and lowest < 0:
            raise InputError(f"an image holds {lowest}; the Jaccard similarity is defined for values >= 0")
        return images

    def _search(self, left: Image, right: Image) -> Disparity:
        cost = COSTS[self.cost]
        high = self.min_disparity + self.num_disparities
        box = BoxMatch(left, right, cost, self.block_size, self.min_disparity, high, self.threads or cpu_count())
        return box.winners(cost.fit if self.subpixel == "auto" else self.subpixel).disparity

    def _search_right(self, left: Image, right: Image) -> Disparity:
        # Seen in a mirror, the right image is a left image: u' = W - 1 - u keeps u_left - u_right.
        mirrored = self._search(np.ascontiguousarray(right[:, ::-1]), np.ascontiguousarray(left[:, ::-1]))
        return np.ascontiguousarray(mirrored[:, ::-1])
