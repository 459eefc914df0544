"""`StereoMatcher`: a classical stereo matcher as one frozen description, and what runs it."""

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np

from twinlens.errors import InputError, unknown
from twinlens.matching import refine
from twinlens.matching.checks import amount, check_block_size, whole
from twinlens.matching.costs import COSTS
from twinlens.matching.images import Disparity, Image, pair
from twinlens.matching.search import Search, search
from twinlens.matching.strips import cpu_count
from twinlens.matching.supports import SUPPORTS, Settings, levels
from twinlens.matching.transforms import clipped_slope

SUBPIXEL = ("auto", "none", "parabola", "v")
PREFILTERS = ("none", "xsobel")
OPTIMISATIONS = {
    "wta": "each pixel on its own: winner takes all",
    "sgm4": "semi-global, along rows and columns",
    "sgm8": "semi-global, along rows, columns and diagonals",
}


@dataclass(frozen=True)
class StereoMatcher:
    """A stereo matcher: what is compared, over which window, how the winner is chosen and refined.

    cost: a name of `COSTS`. block_size: side of the window, odd, in pixels. The search covers the disparities
    min_disparity <= d < min_disparity + num_disparities, in pixels, d = u_left - u_right.
    support: a name of `SUPPORTS`; contrast, gamma_similar, gamma_near, epsilon, noise: see `supports.Settings`.
    census_window: side of the window of the census and rank transforms.
    prefilter: "none", or "xsobel": compare the clipped horizontal slopes of the images (`transforms.clipped_slope`).
    optimisation: a name of `OPTIMISATIONS`; p1, p2: its penalties in parts of the largest cost; None: the cost's own.
    subpixel: "auto" (the fit that suits the cost), "v", "parabola" or "none".

    What follows makes pixels unknown, so density falls, in this order; 0 or None is off.
    uniqueness: percent by which the best rival, two or more candidates away, must cost more than the winner.
    texture: least root mean square horizontal difference in the window, in grey levels of 0..255.
    lr_check: the most, in pixels, by which left and right disparity may differ.
    speckle_size: the least pixels of a patch; within a patch neighbours differ by at most speckle_range pixels.
    median: side of a median over the known pixels, density stays. fill: "none", or "background", which makes every
    pixel of a map known that has one: by the farther of the known neighbours in its row.

    threads: None for all processors; the answer is the same bytes for any number of them.

    Borders: images are continued by their edge pixels (regions of the cross, weighted and guided supports end at the
    edge instead), so every pixel gets an answer, unless none of its partners u - d lies inside the right image: it is
    then unknown, +inf. Of equal costs the smallest disparity wins. A winner at the end of its pixel's range gets no
    sub-pixel fit.

    Numbers: uint8 and uint16 are summed in whole numbers, without loss; only the normalised costs (ncc, zncc, jaccard)
    are rounded, to 32-bit floats for uint8 (an error below 1e-6) and 64-bit ones else. Correlations that differ by less
    than that count as they round. Floats are summed in 64 bits: costs that differ by less than 2^-40 of the largest
    count as equal, and of costs that only rounding tells apart any may win. A window of one value correlates with
    nothing: its ZNCC costs 1 with every partner; a window of zeros has an NCC cost of 1, and two of them a Jaccard cost
    of 0. Windows may be wider than the image, and the range too.

    >>> StereoMatcher(cost="sad", block_size=7).num_disparities
    64
    """

    cost: str = "zncc"
    block_size: int = 9
    num_disparities: int = 64
    min_disparity: int = 0
    support: str = "fixed"
    census_window: int = 7
    prefilter: str = "none"
    contrast: float = 20.0
    gamma_similar: float = 12.0
    gamma_near: float = 12.0
    epsilon: float = 1e-4
    noise: float = 2.0
    optimisation: str = "wta"
    p1: float | None = None
    p2: float | None = None
    subpixel: str = "auto"
    uniqueness: float = 0.0
    texture: float = 0.0
    lr_check: float | None = None
    speckle_size: int = 0
    speckle_range: float = 1.0
    median: int = 0
    fill: str = "none"
    threads: int | None = None

    def __post_init__(self) -> None:
        for kind, name, known in (
            ("cost", self.cost, COSTS),
            ("support", self.support, SUPPORTS),
            ("optimisation", self.optimisation, OPTIMISATIONS),
            ("sub-pixel fit", self.subpixel, SUBPIXEL),
            ("filling", self.fill, refine.FILLS),
            ("prefilter", self.prefilter, PREFILTERS),
        ):
            if name not in known:
                raise unknown(kind, str(name), known)
        check_block_size("block_size", self.block_size)
        check_block_size("census_window", self.census_window)
        whole("num_disparities", self.num_disparities, 1)
        whole("min_disparity", self.min_disparity)
        whole("speckle_size", self.speckle_size, 0)
        if self.median != 0:
            check_block_size("median", self.median)
        if self.threads is not None:
            whole("threads", self.threads, 1)
        self._check_amounts()
        self._check_combination()

    def _check_amounts(self) -> None:
        for name in ("texture", "uniqueness"):
            if getattr(self, name) is None:
                object.__setattr__(self, name, 0.0)
        for name in ("contrast", "noise", "speckle_range", "texture", "uniqueness"):
            amount(name, getattr(self, name))
        for name in ("lr_check", "p1", "p2"):
            if getattr(self, name) is not None:
                amount(name, getattr(self, name))
        for name in ("gamma_similar", "gamma_near", "epsilon"):
            amount(name, getattr(self, name), above=True)
        if self.uniqueness >= 100:
            raise InputError(f"uniqueness is {self.uniqueness}; it is a percentage below 100")
        small, large = self.penalties
        if not small <= large <= 1:
            raise InputError(f"p1 and p2 are {small} and {large}; they are parts of the largest cost, p1 <= p2 <= 1")

    def _check_combination(self) -> None:
        if SUPPORTS[self.support].pixelwise and COSTS[self.cost].normalised:
            raise InputError(
                f"cost {self.cost!r} compares statistics of whole windows, support {self.support!r} gathers single "
                "pixels; use it with sad, ssd, census, rank or birchfield_tomasi"
            )

    @property
    def penalties(self) -> tuple[float, float]:
        """(p1, p2) of the semi-global optimisation, in parts of the largest cost."""
        cost = COSTS[self.cost]
        return cost.p1 if self.p1 is None else self.p1, cost.p2 if self.p2 is None else self.p2

    def replace(self, **changes: Any) -> "StereoMatcher":
        """The same matcher with some fields changed, checked anew."""
        return dataclasses.replace(self, **changes)

    def match(self, left: Any, right: Any) -> Disparity:
        """The left image's disparity, (H, W) float32 in pixels, +inf where unknown."""
        images = self._checked(left, right)
        disparity = self._found(*images)
        if self.lr_check is not None:
            disparity = refine.consistent(disparity, _mirrored(self._found(*_swapped(*images))), self.lr_check)
        return self._polished(disparity)

    def match_pair(self, left: Any, right: Any) -> tuple[Disparity, Disparity]:
        """The disparities of the left and of the right image, each (H, W); a point has the same sign in both."""
        images = self._checked(left, right)
        ours, theirs = self._found(*images), self._found(*_swapped(*images))
        if self.lr_check is not None:
            ours, theirs = (
                refine.consistent(ours, _mirrored(theirs), self.lr_check),
                refine.consistent(theirs, _mirrored(ours), self.lr_check),
            )
        return self._polished(ours), _mirrored(self._polished(theirs))

    def _checked(self, left: Any, right: Any) -> tuple[Image, Image]:
        images = pair(left, right)
        if self.cost == "jaccard" and images[0].dtype.kind == "f":
            lowest = min(float(image.min()) for image in images)
            if lowest < 0:
                raise InputError(f"an image holds {lowest}; the Jaccard similarity is defined for values >= 0")
        return images

    def _found(self, left: Image, right: Image) -> Disparity:
        images = [clipped_slope(grey) for grey in levels(left, right)] if self.prefilter == "xsobel" else [left, right]
        found = search(self._task(), images[0], images[1])
        disparity = found.disparity
        if self.uniqueness > 0:
            disparity = refine.unique(disparity, found.cost, found.rival, self.uniqueness)
        if self.texture > 0:
            disparity = refine.textured(disparity, left, self.block_size, self.texture)
        return disparity

    def _task(self) -> Search:
        cost = COSTS[self.cost]
        return Search(
            cost=cost,
            side=self.block_size,
            low=self.min_disparity,
            count=self.num_disparities,
            descriptor=self.census_window,
            support=SUPPORTS[self.support],
            settings=Settings(self.contrast, self.gamma_similar, self.gamma_near, self.epsilon, self.noise),
            paths={"wta": 0, "sgm4": 4, "sgm8": 8}[self.optimisation],
            penalties=self.penalties,
            fit=cost.fit if self.subpixel == "auto" else self.subpixel,
            rivals=self.uniqueness > 0,
            threads=self.threads or cpu_count(),
        )

    def _polished(self, disparity: Disparity) -> Disparity:
        if self.speckle_size > 0:
            disparity = refine.without_speckles(disparity, self.speckle_size, self.speckle_range)
        if self.median > 1:
            disparity = refine.median(disparity, self.median)
        return refine.filled(disparity) if self.fill == "background" else disparity


def _mirrored(image: Any) -> Any:
    return np.ascontiguousarray(image[:, ::-1])


def _swapped(left: Image, right: Image) -> tuple[Image, Image]:
    # Seen in a mirror, the right image is a left image: u' = W - 1 - u keeps u_left - u_right.
    return _mirrored(right), _mirrored(left)
