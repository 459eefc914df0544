"""`StereoMatcher`: a classical stereo matcher, a frozen dataclass of its options, and its search."""

import functools
from collections.abc import Callable, Collection
from dataclasses import KW_ONLY, dataclass
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray

from twinlens.errors import InputError, check_int, check_known, check_number
from twinlens.machine import processor_count
from twinlens.matching import box, refine
from twinlens.matching.box import (
    FITS,
    BoxMatch,
    Rows,
    Volume,
    Winners,
    blank,
    in_lanes,
    in_strips,
    limits,
)
from twinlens.matching.confidence import CONFIDENCES, confidence_map
from twinlens.matching.costs import (
    COSTS,
    descriptor_model,
    find_cost,
    largest_cost,
    numbers,
)
from twinlens.matching.descriptors import descriptor_costs
from twinlens.matching.external import check_model, descriptors, model_hashes
from twinlens.matching.images import (
    Confidence,
    Disparity,
    Image,
    clipped_slope,
    described,
    levels,
    pair,
)
from twinlens.matching.options import RangeMatcher, check_block_size
from twinlens.matching.semiglobal import Penalties, Sweeps, quantised, stored
from twinlens.matching.supports import SUPPORTS, Strip

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
class StereoMatcher(RangeMatcher):
    """A classical stereo matcher: its matching cost, support window, optimisation and refinement.

    The options are described in their annotations, which `twinlens methods` lists. The steps run in this order: cost,
    support, optimisation, winner-take-all with sub-pixel fit, uniqueness, texture, lr_check, speckles, median, fill.
    uniqueness, texture, lr_check and speckle_size make pixels unknown.

    Borders: images are padded with their edge pixels (the cross, weighted and guided supports end at the edge instead),
    so every pixel with a candidate u - d inside the right image has a disparity. Windows and ranges may be wider than
    the image. Of equal costs the smallest disparity wins. At the ends of the range there is no sub-pixel fit.

    Accuracy: uint8 and uint16 images are summed exactly, in integers. Only the normalised costs (ncc, zncc,
    jaccard) are rounded, to float32 for uint8 (an error below 1e-6) and float64 otherwise. Floating-point images are
    summed in float64: costs that differ by less than 2^-40 of the largest count as equal. A window of one value has a
    ZNCC cost of 1 with every partner; a window of zeros has an NCC cost of 1, and two of them a Jaccard cost of 0.
    Results do not depend on the number of threads.

    Raises InputError for an option with a wrong value, and for a cost that the support cannot aggregate.

    >>> StereoMatcher(cost="sad", block_size=7).num_disparities
    64
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
        for name, (kind, known) in NAMED_VALUES.items():
            check_known(kind, getattr(self, name), known)
        cost = find_cost(self.cost)
        check_block_size("block_size", self.block_size)
        check_block_size("census_window", self.census_window)
        check_block_size("median", 1 if self.median == 0 else self.median)
        super().__post_init__()
        check_int("speckle_size", self.speckle_size, 0)
        check_int("threads", 1 if self.threads is None else self.threads, 1)
        for name in ("texture", "uniqueness"):
            if getattr(self, name) is None:
                object.__setattr__(self, name, 0.0)
        for name in ("contrast", "noise", "speckle_range", "texture", "uniqueness"):
            check_number(name, getattr(self, name), "a number >= 0", least=0)
        for name in ("lr_check", "p1", "p2"):
            check_number(
                name,
                0 if getattr(self, name) is None else getattr(self, name),
                "a number >= 0",
                least=0,
            )
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
        if SUPPORTS[self.support].pixelwise and cost.scoring != "sum":
            raise InputError(
                f"cost {self.cost!r} compares statistics of whole windows, but support {self.support!r} aggregates "
                "costs of single pixels; use it with sad, ssd, census, rank or birchfield_tomasi"
            )

    @property
    def penalties(self) -> tuple[float, float]:
        """(p1, p2) of the semi-global optimisation, in parts of the largest cost."""
        cost = find_cost(self.cost)
        return (
            cost.p1 if self.p1 is None else self.p1,
            cost.p2 if self.p2 is None else self.p2,
        )

    @property
    def window(self) -> int:
        """Side of the window of pixels that a cost reads before any semi-global optimisation: with the transform's."""
        return self.block_size + (
            self.census_window - 1
            if find_cost(self.cost).transform in ("census", "rank")
            else 0
        )

    @property
    def content(self) -> str:
        """The hashes of the files of a descriptor network; "" for other costs."""
        model = descriptor_model(self.cost)
        return "" if model is None else model_hashes(model)

    def check_parts(self) -> None:
        """FileError if there is no such descriptor network, MissingExtraError if onnxruntime is not installed."""
        if model := descriptor_model(self.cost):
            check_model(model)

    def cost_volume(self, left: Any, right: Any) -> NDArray[np.float32]:
        """The costs (H, W, num_disparities) that the winner-take-all step minimises; +inf without a partner.

        Candidate j has disparity min_disparity + j. Units: those of the measure in `matching.measures`, 1 - similarity
        for similarities; summed over the support's windows; of semi-global matching, the mean over its paths.
        """
        search = self.search(*pair(left, right))
        volume = np.full((*search.left.shape, self.num_disparities), np.inf, np.float32)
        if search.count > 0:
            first = search.low - self.min_disparity

            def keep(y: int, rows: Volume) -> None:
                volume[y : y + len(rows), :, first : first + search.count] = rows[
                    ..., : search.count
                ]

            search.costs(0, len(volume), keep)
        return volume

    def _without_confidence(self) -> Self:
        return self.replace(confidence="none")

    def _match(self, left: Any, right: Any) -> tuple[Disparity, Confidence | None]:
        left, right = pair(left, right)
        disparity = self._refined(left, right)
        if self.confidence == "none":
            return disparity, None
        return disparity, confidence_map(
            self.cost_volume(left, right), self.confidence, self.min_disparity
        )

    def _refined(self, left: Image, right: Image) -> Disparity:
        disparity = self._raw_disparity(left, right)
        if self.lr_check is not None:
            # Mirrored, the right image becomes a left image: u' = W - 1 - u keeps u_left - u_right.
            of_right = _mirrored(
                self._raw_disparity(_mirrored(right), _mirrored(left), mirrored=True)
            )
            disparity = refine.consistent(disparity, of_right, self.lr_check)
        if self.speckle_size > 0:
            disparity = refine.without_speckles(
                disparity, self.speckle_size, self.speckle_range
            )
        if self.median > 1:
            disparity = refine.median(disparity, self.median)
        return refine.filled(disparity) if self.fill == "background" else disparity

    def search(self, left: Image, right: Image, *, mirrored: bool = False) -> "Search":
        """The search of two images as `images.pair` returns them, or `mirrored` ones, which no network describes."""
        if (
            self.cost == "jaccard"
            and (lowest := min(float(left.min()), float(right.min()))) < 0
        ):
            raise InputError(
                f"an image holds {lowest}; the Jaccard similarity is defined for values >= 0"
            )
        images = (
            [clipped_slope(grey) for grey in levels(left, right)]
            if self.prefilter == "xsobel"
            else [left, right]
        )
        return Search(self, *images, mirrored=mirrored)

    def _raw_disparity(
        self, left: Image, right: Image, *, mirrored: bool = False
    ) -> Disparity:
        winners = self.search(left, right, mirrored=mirrored).winners()
        disparity = winners.disparity
        if self.uniqueness > 0:
            disparity = refine.unique(
                disparity, winners.cost, winners.rival, self.uniqueness
            )
        if self.texture > 0:
            disparity = refine.textured(disparity, left, self.block_size, self.texture)
        return disparity


def _mirrored(image: Any) -> Any:
    return np.ascontiguousarray(image[:, ::-1])


class Search:
    """The search of one image pair: cost, support and optimisation, strip by strip."""

    def __init__(
        self,
        matcher: StereoMatcher,
        left: Image,
        right: Image,
        *,
        mirrored: bool = False,
    ) -> None:
        width, low = left.shape[1], matcher.min_disparity
        self.matcher, self.left, self.right = matcher, left, right
        self.cost, self.support, self.side = (
            find_cost(matcher.cost),
            SUPPORTS[matcher.support],
            matcher.block_size,
        )
        self.mirrored = mirrored
        self.low, self.high = (
            max(low, 1 - width),
            min(low + matcher.num_disparities, width),
        )
        self.count = self.high - self.low
        self.depth = in_lanes(self.count)
        # The windows whose costs the support aggregates, the widest first.
        self.sides = (1,) if self.support.pixelwise else self.support.windows(self.side)
        self.paths = PATHS[matcher.optimisation]
        self.fit = self.cost.fit if matcher.subpixel == "auto" else matcher.subpixel
        self.rivals = matcher.uniqueness > 0
        self.threads = matcher.threads or processor_count()

    def winners(self) -> Winners:
        """The winner at every pixel of the left image."""
        if self.count <= 0:
            return Winners.empty(self.left.shape)
        if self._in_boxes:
            boxes = self._boxes(self.side)
            if self.paths:
                return self._semiglobal(boxes)
            if len(boxes) == 1:
                best = boxes[0].winners(self.fit, costs=self.rivals)
                if not self.cost.offset:
                    return best
                # Similarities that differ by rounding alone become equal.
                return Winners(
                    best.disparity,
                    *(
                        np.round(s + self.cost.offset, 6)
                        for s in (best.cost, best.rival)
                    ),
                )
        return self._semiglobal(()) if self.paths else self._local()

    def costs(self, start: int, stop: int, keep: Callable[[int, Volume], None]) -> None:
        """Call keep(y, costs) with the costs (rows, W, depth) of all rows start..stop, in parts; see `cost_volume`."""
        if not self.paths:
            rows = self._aggregated()

            def work(y0: int, y1: int) -> None:
                keep(start + y0, rows(start + y0, start + y1) / self._unit)

            in_strips(work, stop - start, self.support.strip, self.threads)
            return
        sweeps, gain = self._sweeps(self._boxes(self.side) if self._in_boxes else ())

        def on_row(y: int, sums: NDArray[np.uint16]) -> None:
            if start <= y < stop:
                costs = sums[None] / (gain * self.paths * self._unit)
                blank(costs, self.low, self.count)
                keep(y, costs)

        sweeps.winners(self.threads, rivals=False, on_row=on_row)

    def winner_at(self, u: int, v: int) -> tuple[NDArray[np.float64], int, float]:
        """Of a pixel: the costs (count,), the winner's place among them, and its disparity with the sub-pixel fit."""
        from twinlens.matching.kernels.winners import winners_of_rows

        parts: list[Volume] = []
        self.costs(v, v + 1, lambda _, costs: parts.append(costs))
        exact = self.paths or not self._in_boxes
        slack = 0.0 if exact else self._boxes(self.side)[0].slack / self._unit
        best = Winners.empty((1, self.left.shape[1]))
        settings = (
            self.depth,
            self.low,
            self.count,
            FITS[self.fit],
            limits(np.float64, slack),
        )
        winners_of_rows(parts[0].reshape(-1), *settings, *best.rows(0, 1))
        costs = parts[0][0, u, : self.count]
        return (
            costs,
            int(np.argmax(costs <= costs.min() + slack)),
            float(best.disparity[0, u]),
        )

    @property
    def _unit(self) -> float:
        """The kernels' cost over that of `matching.measures`: their ZSSD is n times the sum of squares."""
        return float(self.sides[0]) ** 2 if self.cost.growth == 2 else 1.0

    @property
    def _in_boxes(self) -> bool:
        """Whether the kernels of square windows compute the costs, without a volume."""
        windowed = self.cost.scoring == "zsad" or self.cost.term == "descriptor"
        return self.support.halo * (self.side // 2) == 0 and not windowed

    def _boxes(self, side: int) -> tuple[BoxMatch, ...]:
        transform, window = self.cost.transform, self.matcher.census_window
        pairs = zip(
            *(described(image, transform, window) for image in (self.left, self.right)),
            strict=True,
        )
        return tuple(
            BoxMatch(a, b, self.cost, side, self.low, self.high, self.threads)
            for a, b in pairs
        )

    @functools.cached_property
    def _descriptors(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """The descriptors (H, W, C) of both images, computed once and never of mirrored images."""
        model, step = (
            descriptor_model(self.matcher.cost) or "",
            -1 if self.mirrored else 1,
        )
        one, other = (
            descriptors(model, image[:, ::step])[:, ::step]
            for image in (self.left, self.right)
        )
        return one, other

    def _source(self, side: int) -> Rows:
        if self.cost.term == "descriptor":
            return descriptor_costs(*self._descriptors, side, self.low, self.depth)
        if self.cost.scoring == "zsad":
            return box.zero_mean_absolute(
                self.left, self.right, side, self.low, self.depth
            )
        boxes = self._boxes(side)
        kind: type[np.generic] = np.float64
        if self.support.integer_sums:
            sums = numbers(self.cost, boxes[0].left.dtype, self.side * len(boxes)).sums
            kind = np.uint32 if sums in (np.uint16, np.uint32) else np.float64
        return box.box_sums(boxes, 1.0, self.cost.offset, kind)

    def _aggregated(self) -> Rows:
        """The costs after aggregation; +inf where there is no candidate."""
        support, halo = self.support, self.support.halo * (self.side // 2)
        sources = [self._source(side) for side in self.sides]
        rest = *levels(self.left, self.right), self.low, self.matcher

        def rows(start: int, stop: int) -> Volume:
            first, last = max(0, start - halo), min(len(self.left), stop + halo)
            volumes = tuple(source(first, last) for source in sources)
            for each in volumes if support.masked else ():
                blank(each, self.low, self.count)
            costs = (
                support.aggregate(Strip(volumes, first, start, stop, *rest))
                if support.aggregate
                else volumes[0]
            )
            blank(costs, self.low, self.count)
            return costs

        return rows

    def _local(self) -> Winners:
        from twinlens.matching.kernels.winners import winners_of_rows

        winners, rows = Winners.empty(self.left.shape, self.rivals), self._aggregated()
        settings = self.depth, self.low, self.count, FITS[self.fit], limits(np.float64)

        def work(start: int, stop: int) -> None:
            winners_of_rows(
                rows(start, stop).reshape(-1), *settings, *winners.rows(start, stop)
            )

        in_strips(work, len(self.left), self.support.strip, self.threads)
        return winners

    def _semiglobal(self, boxes: tuple[BoxMatch, ...]) -> Winners:
        return self._sweeps(boxes)[0].winners(self.threads, rivals=self.rivals)

    def _sweeps(self, boxes: tuple[BoxMatch, ...]) -> tuple[Sweeps, float]:
        """The semi-global search of the boxes' costs or, without boxes, of the aggregated ones; and the costs' gain."""
        whole_numbers = bool(boxes) and np.dtype(boxes[0].numbers.scores).kind != "f"
        side, parts = (self.side, 1) if boxes else (self.sides[0], self.support.parts)
        full = (
            largest_cost(
                self.cost, self.left, self.right, side, self.matcher.census_window
            )
            * parts
        )
        gain, penalties = Penalties.scaled(self.matcher.penalties, full, whole_numbers)
        shape = *self.left.shape, self.depth
        if boxes:
            costs = quantised(
                boxes, gain, self.cost.offset * gain, penalties, self.threads
            )
        else:
            rows = self._aggregated()

            def scaled(start: int, stop: int) -> Volume:
                return np.minimum(
                    np.rint(np.maximum(rows(start, stop), 0) * gain), penalties.top
                )

            costs = stored(shape, penalties, scaled, self.support.strip, self.threads)
        return Sweeps(
            costs, shape, self.paths, penalties, self.low, self.count, self.fit
        ), gain
