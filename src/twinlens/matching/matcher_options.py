"""`MatcherOptions`: the options of `StereoMatcher`, each declared once, and the checks of their values."""

from dataclasses import KW_ONLY, dataclass
from typing import Annotated

from twinlens.errors import InputError
from twinlens.matching.box import FITS
from twinlens.matching.confidence import CONFIDENCES
from twinlens.matching.costs import COSTS, Cost, find_cost
from twinlens.matching.supports import SUPPORTS, SupportOptions
from twinlens.settings import Setting

OPTIMISATIONS = {
    "wta": "winner takes all, for each pixel on its own",
    "sgm4": "semi-global, along rows and columns",
    "sgm8": "semi-global, along rows, columns and diagonals",
}
PATHS = {"wta": 0, "sgm4": 4, "sgm8": 8}


@dataclass(frozen=True)
class MatcherOptions(SupportOptions):
    """The options of a classical matcher; their annotations describe them, and `twinlens methods` lists them.

    Raises InputError for an option with a wrong value, and for a cost that the support cannot aggregate.
    """

    cost: Annotated[
        str,
        Setting(
            f"Matching cost: {', '.join(COSTS)}, learned, or a descriptor network, onnx:FILE."
        ),
    ] = "zncc"
    block_size: Annotated[
        int, Setting("Side of the window in pixels; odd.", least=1, odd=True)
    ] = 9
    _: KW_ONLY
    support: Annotated[
        str,
        Setting(
            f"Support region over which costs are aggregated: {', '.join(SUPPORTS)}.",
            choices=SUPPORTS,
        ),
    ] = "fixed"
    census_window: Annotated[
        int,
        Setting(
            "Side of the window of the census and rank transforms; odd.",
            least=1,
            odd=True,
        ),
    ] = 7
    prefilter: Annotated[
        str,
        Setting(
            "none; xsobel: compare clipped horizontal Sobel derivatives, as StereoBM does.",
            choices=("none", "xsobel"),
        ),
    ] = "none"
    optimisation: Annotated[
        str,
        Setting(
            "; ".join(f"{name}: {text}" for name, text in OPTIMISATIONS.items()) + ".",
            choices=OPTIMISATIONS,
        ),
    ] = "wta"
    p1: Annotated[
        float | None,
        Setting(
            "Penalty for one-pixel steps, as a fraction of the largest cost; none: by cost.",
            least=0,
        ),
    ] = None
    p2: Annotated[
        float | None,
        Setting(
            "Penalty for larger steps, as a fraction of the largest cost; none: by cost.",
            least=0,
        ),
    ] = None
    subpixel: Annotated[
        str,
        Setting(
            "Sub-pixel fit: v, parabola, none, or auto: the fit that suits the cost.",
            choices=("auto", *FITS),
        ),
    ] = "auto"
    uniqueness: Annotated[
        float,
        Setting(
            "Percent by which costs two or more pixels away must exceed the least; 0: off.",
            least=0,
            below=100,
        ),
    ] = 0.0
    texture: Annotated[
        float,
        Setting(
            "Least RMS horizontal difference in the window, in grey levels of 0..255; 0: off.",
            least=0,
        ),
    ] = 0.0
    lr_check: Annotated[
        float | None,
        Setting(
            "Largest difference of left and right disparity in pixels; none: off.",
            least=0,
        ),
    ] = None
    speckle_size: Annotated[
        int, Setting("Patches of fewer pixels become unknown; 0: off.", least=0)
    ] = 0
    speckle_range: Annotated[
        float,
        Setting(
            "Largest difference in pixels between neighbours of one patch.", least=0
        ),
    ] = 1.0
    median: Annotated[
        int,
        Setting(
            "Side of a median filter over known pixels; odd; 0: off.",
            least=1,
            odd=True,
            or_zero=True,
        ),
    ] = 0
    fill: Annotated[
        str,
        Setting(
            "none; background: the smaller of the two nearest known disparities in the row.",
            choices=("none", "background"),
        ),
    ] = "none"
    confidence: Annotated[
        str,
        Setting(
            f"none, or also return the confidence of the winner before refinement: {', '.join(CONFIDENCES)}.",
            choices=("none", *CONFIDENCES),
        ),
    ] = "none"
    threads: Annotated[
        int | None, Setting("Number of threads; none: all processors.", least=1)
    ] = None

    def __post_init__(self) -> None:
        find_cost(self.cost)
        for name in ("texture", "uniqueness"):
            if getattr(self, name) is None:  # `none` switches these off too
                object.__setattr__(self, name, 0.0)
        super().__post_init__()
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
