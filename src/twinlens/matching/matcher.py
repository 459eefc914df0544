"""`StereoMatcher`: a classical stereo matcher as one frozen description of its options."""

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from twinlens.errors import InputError, unknown
from twinlens.matching import refine
from twinlens.matching.costs import COSTS
from twinlens.matching.images import Disparity, Image, levels, pair
from twinlens.matching.options import (
    MinDisparity,
    NumDisparities,
    RangeMatcher,
    amount,
    check_block_size,
    check_range,
    whole,
)
from twinlens.matching.search import Search, search
from twinlens.matching.strips import cpu_count
from twinlens.matching.supports import SUPPORTS, Settings
from twinlens.matching.transforms import clipped_slope

SUBPIXEL = ("auto", "none", "parabola", "v")
PREFILTERS = ("none", "xsobel")
OPTIMISATIONS = {
    "wta": "winner takes all, for each pixel on its own",
    "sgm4": "semi-global, along rows and columns",
    "sgm8": "semi-global, along rows, columns and diagonals",
}


@dataclass(frozen=True)
class StereoMatcher(RangeMatcher):
    """A classical stereo matcher: its matching cost, support window, optimisation and refinement.

    The options are described in their annotations, which `twinlens methods` lists. The steps run in this order: cost,
    support, optimisation, winner-take-all with sub-pixel fit, uniqueness, texture, lr_check, speckles, median, fill.
    uniqueness, texture, lr_check and speckle_size make pixels unknown.

    Borders: images are continued by their edge pixels (regions of the cross, weighted and guided supports end at the
    edge instead), so every pixel has a disparity unless none of its partners u - d is inside the right image: then it
    is +inf. Of equal costs the smallest disparity wins. A winner at the end of its pixel's range has no sub-pixel fit.

    Accuracy: uint8 and uint16 images are summed exactly, in integers. Only the normalised costs (ncc, zncc,
    jaccard) are rounded, to float32 for uint8 (an error below 1e-6) and float64 otherwise. Floating-point images are
    summed in float64: costs that differ by less than 2^-40 of the largest count as equal. A window of one value has a
    ZNCC cost of 1 with every partner; a window of zeros has an NCC cost of 1, and two of them a Jaccard cost of 0.
    Windows and ranges may be wider than the image.

    Results do not depend on the number of threads.

    Raises
    ------
    InputError
        An option has a wrong value, or the support cannot take the cost.

    Examples
    --------
    >>> StereoMatcher(cost="sad", block_size=7).num_disparities
    64
    """

    cost: Annotated[str, f"Matching cost: {', '.join(COSTS)}."] = "zncc"
    block_size: Annotated[int, "Side of the window in pixels; odd."] = 9
    num_disparities: NumDisparities = 64
    min_disparity: MinDisparity = 0
    support: Annotated[str, f"Support region over which costs are aggregated: {', '.join(SUPPORTS)}."] = "fixed"
    census_window: Annotated[int, "Side of the window of the census and rank transforms; odd."] = 7
    prefilter: Annotated[str, "none, or xsobel: compare clipped horizontal Sobel derivatives, as StereoBM does."] = (
        "none"
    )
    contrast: Annotated[float, "Support cross: difference in grey levels of 0..255 at which an arm ends."] = 20.0
    gamma_similar: Annotated[float, "Support weighted: grey levels over which a weight falls to 1/e."] = 12.0
    gamma_near: Annotated[float, "Support weighted: pixels over which a weight falls to 1/e."] = 12.0
    epsilon: Annotated[float, "Support guided: variance below which the filter smooths, for grey levels in 0..1."] = (
        1e-4
    )
    noise: Annotated[float, "Support adaptive: standard deviation of the image noise, in grey levels of 0..255."] = 2.0
    optimisation: Annotated[str, "; ".join(f"{name}: {text}" for name, text in OPTIMISATIONS.items()) + "."] = "wta"
    p1: Annotated[
        float | None,
        "Semi-global penalty for steps of one disparity, as a fraction of the largest cost; none: depends on the cost.",
    ] = None
    p2: Annotated[
        float | None,
        "Semi-global penalty for larger steps, as a fraction of the largest cost; none: depends on the cost.",
    ] = None
    subpixel: Annotated[str, "Sub-pixel fit: v, parabola, none, or auto: the fit that suits the cost."] = "auto"
    uniqueness: Annotated[
        float,
        "Percent by which the best cost two or more disparities away must exceed the least cost; 0: off.",
    ] = 0.0
    texture: Annotated[
        float, "Least root mean square horizontal difference in the window, in grey levels of 0..255; 0: off."
    ] = 0.0
    lr_check: Annotated[
        float | None, "Largest difference in pixels between the left and the right disparity; none: off."
    ] = None
    speckle_size: Annotated[int, "Patches of fewer pixels become unknown; 0: off."] = 0
    speckle_range: Annotated[float, "Largest difference in pixels between neighbours of one patch."] = 1.0
    median: Annotated[int, "Side of a median filter over known pixels; odd; 0: off."] = 0
    fill: Annotated[
        str,
        "none, or background: fill unknown pixels with the smaller of the two nearest known disparities in the row.",
    ] = "none"
    threads: Annotated[int | None, "Number of threads; none: all processors."] = None

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
        check_range(self.num_disparities, self.min_disparity)
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
                f"cost {self.cost!r} compares statistics of whole windows, but support {self.support!r} gathers costs "
                "of single pixels; use it with sad, ssd, census, rank or birchfield_tomasi"
            )

    @property
    def penalties(self) -> tuple[float, float]:
        """(p1, p2) of the semi-global optimisation, in parts of the largest cost."""
        cost = COSTS[self.cost]
        return cost.p1 if self.p1 is None else self.p1, cost.p2 if self.p2 is None else self.p2

    def _match(self, left: Any, right: Any) -> Disparity:
        images = self._checked(left, right)
        disparity = self._raw_disparity(*images)
        if self.lr_check is not None:
            disparity = refine.consistent(disparity, _mirrored(self._raw_disparity(*_swapped(*images))), self.lr_check)
        return self._refined(disparity)

    def match_pair(self, left: Any, right: Any) -> tuple[Disparity, Disparity]:
        """The disparities of the left and of the right image, (H, W) each, both u_left - u_right; see `match`."""
        images = self._checked(left, right)
        ours, theirs = self._raw_disparity(*images), self._raw_disparity(*_swapped(*images))
        if self.lr_check is not None:
            ours, theirs = (
                refine.consistent(ours, _mirrored(theirs), self.lr_check),
                refine.consistent(theirs, _mirrored(ours), self.lr_check),
            )
        return self._refined(ours), _mirrored(self._refined(theirs))

    def _checked(self, left: Any, right: Any) -> tuple[Image, Image]:
        images = pair(left, right)
        if self.cost == "jaccard" and images[0].dtype.kind == "f":
            lowest = min(float(image.min()) for image in images)
            if lowest < 0:
                raise InputError(f"an image holds {lowest}; the Jaccard similarity is defined for values >= 0")
        return images

    def _raw_disparity(self, left: Image, right: Image) -> Disparity:
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

    def _refined(self, disparity: Disparity) -> Disparity:
        if self.speckle_size > 0:
            disparity = refine.without_speckles(disparity, self.speckle_size, self.speckle_range)
        if self.median > 1:
            disparity = refine.median(disparity, self.median)
        return refine.filled(disparity) if self.fill == "background" else disparity


def _mirrored(image: Any) -> Any:
    return np.ascontiguousarray(image[:, ::-1])


def _swapped(left: Image, right: Image) -> tuple[Image, Image]:
    # Mirrored, the right image becomes a left image: u' = W - 1 - u keeps u_left - u_right.
    return _mirrored(right), _mirrored(left)
