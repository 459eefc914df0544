"""`MatcherOptions`: the options of `StereoMatcher`, each declared once, and the checks of their values."""

from collections.abc import Collection
from dataclasses import KW_ONLY, dataclass
from typing import Annotated

from twinlens.errors import InputError, check_int, check_known, check_number
from twinlens.matching.box import FITS
from twinlens.matching.confidence import CONFIDENCES
from twinlens.matching.contract import RangeMatcher, check_block_size
from twinlens.matching.costs import COSTS, Cost, find_cost
from twinlens.matching.supports import SUPPORTS

OPTIMISATIONS = {
    "wta": "winner takes all, for each pixel on its own",
    "sgm4": "semi-global, along rows and columns",
    "sgm8": "semi-global, along rows, columns and diagonals",
}
PATHS = {"wta": 0, "sgm4": 4, "sgm8": 8}
NAMED_VALUES: dict[str, tuple[str, Collection[str]]] = {
    "support": ("support", SUPPORTS),
    "optimisation": ("optimisation", OPTIMISATIONS),
    "subpixel": ("sub-pixel fit", ("auto", *FITS)),
    "fill": ("filling", ("none", "background")),
    "confidence": ("confidence", ("none", *CONFIDENCES)),
    "prefilter": ("prefilter", ("none", "xsobel")),
}
"""Of each option with named values: what messages call it, and the values."""


@dataclass(frozen=True)
class MatcherOptions(RangeMatcher):
    """The options of a classical matcher; their annotations describe them, and `twinlens methods` lists them.

    Raises InputError for an option with a wrong value, and for a cost that the support cannot aggregate.
    """

    cost: Annotated[
        str,
        f"Matching cost: {', '.join(COSTS)}, learned, or a descriptor network, onnx:FILE.",
    ] = "zncc"
    block_size: Annotated[int, "Side of the window in pixels; odd."] = 9
    _: KW_ONLY
    support: Annotated[
        str, f"Support region over which costs are aggregated: {', '.join(SUPPORTS)}."
    ] = "fixed"
    census_window: Annotated[
        int, "Side of the window of the census and rank transforms; odd."
    ] = 7
    prefilter: Annotated[
        str,
        "none; xsobel: compare clipped horizontal Sobel derivatives, as StereoBM does.",
    ] = "none"
    contrast: Annotated[
        float,
        "Support cross: difference in grey levels of 0..255 at which an arm ends.",
    ] = 20.0
    gamma_similar: Annotated[
        float, "Support weighted: grey levels over which a weight falls to 1/e."
    ] = 12.0
    gamma_near: Annotated[
        float, "Support weighted: pixels over which a weight falls to 1/e."
    ] = 12.0
    epsilon: Annotated[
        float,
        "Support guided: variance below which the filter smooths, of grey levels in 0..1.",
    ] = 1e-4
    noise: Annotated[
        float,
        "Support adaptive: standard deviation of the image noise, in grey levels of 0..255.",
    ] = 2.0
    optimisation: Annotated[
        str, "; ".join(f"{name}: {text}" for name, text in OPTIMISATIONS.items()) + "."
    ] = "wta"
    p1: Annotated[
        float | None,
        "Penalty for one-pixel steps, as a fraction of the largest cost; none: by cost.",
    ] = None
    p2: Annotated[
        float | None,
        "Penalty for larger steps, as a fraction of the largest cost; none: by cost.",
    ] = None
    subpixel: Annotated[
        str, "Sub-pixel fit: v, parabola, none, or auto: the fit that suits the cost."
    ] = "auto"
    uniqueness: Annotated[
        float,
        "Percent by which costs two or more pixels away must exceed the least; 0: off.",
    ] = 0.0
    texture: Annotated[
        float,
        "Least RMS horizontal difference in the window, in grey levels of 0..255; 0: off.",
    ] = 0.0
    lr_check: Annotated[
        float | None,
        "Largest difference of left and right disparity in pixels; none: off.",
    ] = None
    speckle_size: Annotated[int, "Patches of fewer pixels become unknown; 0: off."] = 0
    speckle_range: Annotated[
        float, "Largest difference in pixels between neighbours of one patch."
    ] = 1.0
    median: Annotated[
        int, "Side of a median filter over known pixels; odd; 0: off."
    ] = 0
    fill: Annotated[
        str,
        "none; background: the smaller of the two nearest known disparities in the row.",
    ] = "none"
    confidence: Annotated[
        str,
        f"none, or also return the confidence of the winner before refinement: {', '.join(CONFIDENCES)}.",
    ] = "none"
    threads: Annotated[int | None, "Number of threads; none: all processors."] = None

    def __post_init__(self) -> None:
        for name, (kind, values) in NAMED_VALUES.items():
            check_known(kind, getattr(self, name), values)
        find_cost(self.cost)
        super().__post_init__()
        check_block_size("block_size", self.block_size)
        check_block_size("census_window", self.census_window)
        if self.median != 0:
            check_block_size("median", self.median)
        check_int("speckle_size", self.speckle_size, 0)
        if self.threads is not None:
            check_int("threads", self.threads, 1)
        for name in ("texture", "uniqueness"):
            if getattr(self, name) is None:  # `none` switches these off too
                object.__setattr__(self, name, 0.0)
        for name in ("contrast", "noise", "speckle_range", "texture", "uniqueness"):
            check_number(name, getattr(self, name), "a number >= 0", least=0)
        for name in ("lr_check", "p1", "p2"):
            value = getattr(self, name)
            if value is not None:
                check_number(name, value, "a number >= 0", least=0)
        for name in ("gamma_similar", "gamma_near", "epsilon"):
            check_number(name, getattr(self, name), "a number above 0", above=0)
        if self.uniqueness >= 100:
            raise InputError(
                f"uniqueness is {self.uniqueness}; it is a percentage below 100"
            )
        small, large = self.penalties
        if not small <= large <= 1:
            raise InputError(
                f"p1 and p2 are {small} and {large}; they are parts of the largest cost, p1 <= p2 <= 1"
            )
        if SUPPORTS[self.support].pixelwise and self.cost_rule.scoring != "sum":
            raise InputError(
                f"cost {self.cost!r} compares statistics of whole windows, but support {self.support!r} aggregates "
                "costs of single pixels; use it with sad, ssd, census, rank or birchfield_tomasi"
            )

    @property
    def cost_rule(self) -> Cost:
        """How the cost is computed; `cost` is its name."""
        return find_cost(self.cost)

    @property
    def penalties(self) -> tuple[float, float]:
        """(p1, p2) of the semi-global optimisation, in parts of the largest cost."""
        small = self.cost_rule.p1 if self.p1 is None else self.p1
        large = self.cost_rule.p2 if self.p2 is None else self.p2
        return small, large

    @property
    def window(self) -> int:
        """Side of the window of pixels that a cost reads before any semi-global optimisation: with the transform's."""
        if self.cost_rule.transform in ("census", "rank"):
            return self.block_size + self.census_window - 1
        return self.block_size
