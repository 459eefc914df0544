"""`Search`: finds the candidate of lowest cost at every pixel of an image pair, without refining the map.

There are three ways, by the options. Costs of plain square windows are summed and searched in one kernel, without a
cost volume (`box`). Other supports aggregate a cost volume strip by strip (`supports`), and the winners of a strip are
taken before the next one. Semi-global optimisation (`semiglobal`) takes the costs of either way.
"""

import functools
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from twinlens.machine import processor_count
from twinlens.matching import box
from twinlens.matching.box import FITS, BoxMatch, Rows, Volume, Winners, in_strips
from twinlens.matching.costs import descriptor_model, largest_cost, numbers
from twinlens.matching.images import Image, described, levels
from twinlens.matching.matcher_options import PATHS, MatcherOptions
from twinlens.matching.networks import descriptor_costs, descriptors
from twinlens.matching.semiglobal import Penalties, Sweeps, quantised, stored
from twinlens.matching.supports import SUPPORTS, Strip


class Search:
    """The search of one image pair: cost, support and optimisation.

    low, count: the candidates that some pixel of the image can have, disparities low + j for j < count; volumes are
    padded to a `depth` of whole SIMD vectors.
    """

    def __init__(
        self,
        options: MatcherOptions,
        left: Image,
        right: Image,
        *,
        mirrored: bool = False,
    ) -> None:
        width = left.shape[1]
        end = options.min_disparity + options.num_disparities
        self.options = options
        self.left = left
        self.right = right
        self.mirrored = mirrored
        self.cost = options.cost_rule
        self.support = SUPPORTS[options.support]
        self.side = options.block_size
        self.low = max(options.min_disparity, 1 - width)
        self.high = min(end, width)
        self.count = self.high - self.low
        self.depth = box.in_lanes(self.count)
        # The windows whose costs the support aggregates, the widest first.
        self.sides = (1,) if self.support.pixelwise else self.support.windows(self.side)
        self.paths = PATHS[options.optimisation]
        self.fit = self.cost.fit if options.subpixel == "auto" else options.subpixel
        self.rivals = options.uniqueness > 0
        self.threads = options.threads or processor_count()

    def winners(self) -> Winners:
        """The winner at every pixel of the left image."""
        if self.count <= 0:
            return Winners.empty(self.left.shape)
        if self.paths:
            sweeps, _ = self._sweeps()
            return sweeps.winners(self.threads, rivals=self.rivals)
        if self._in_boxes:
            boxes = self._boxes(self.side)
            # A census of many bits has several words, whose costs have to be added up in a volume.
            if len(boxes) == 1:
                return boxes[0].winners(self.fit, costs=self.rivals)
        return self._strip_winners()

    def costs(self, start: int, stop: int, keep: Callable[[int, Volume], None]) -> None:
        """Call keep(y, costs) with the costs (rows, W, depth) of all rows start..stop, in parts; see `cost_volume`."""
        if self.paths:
            self._path_costs(start, stop, keep)
            return
        rows = self._aggregated()

        def work(y0: int, y1: int) -> None:
            keep(start + y0, rows(start + y0, start + y1) / self._unit)

        in_strips(work, stop - start, self.support.strip, self.threads)

    def winner_at(self, u: int, v: int) -> tuple[NDArray[np.float64], int, float]:
        """Of a pixel: the costs (count,), the winner's place among them, and its disparity with the sub-pixel fit."""
        from twinlens.matching.kernels.winners import winners_of_rows

        parts: list[Volume] = []
        self.costs(v, v + 1, lambda _, costs: parts.append(costs))
        # Only the costs of boxes, which may be sums of floats, count as equal within rounding errors.
        slack = 0.0
        if self._in_boxes and not self.paths:
            slack = self._boxes(self.side)[0].slack / self._unit
        best = Winners.empty((1, self.left.shape[1]))
        winners_of_rows(
            parts[0].reshape(-1),
            self.depth,
            self.low,
            self.count,
            FITS[self.fit],
            box.limits(np.float64, slack),
            *best.rows(0, 1),
        )
        costs = parts[0][0, u, : self.count]
        place = int(np.argmax(costs <= costs.min() + slack))
        return costs, place, float(best.disparity[0, u])

    @property
    def _unit(self) -> float:
        """The kernels' cost over that of `matching.measures`: their ZSSD is n times the sum of squares."""
        return float(self.sides[0]) ** 2 if self.cost.growth == 2 else 1.0

    @property
    def _in_boxes(self) -> bool:
        """Whether the kernels of square windows compute the costs, without a volume."""
        windowed = self.cost.scoring == "zsad" or self.cost.term == "descriptor"
        reaches_beyond = self.support.halo * (self.side // 2) > 0
        return not reaches_beyond and not windowed

    def _boxes(self, side: int) -> tuple[BoxMatch, ...]:
        """The window costs of the images, or of each pair of images that the cost's transform makes of them."""
        transform, window = self.cost.transform, self.options.census_window
        lefts = described(self.left, transform, window)
        rights = described(self.right, transform, window)
        return tuple(
            BoxMatch(left, right, self.cost, side, self.low, self.high, self.threads)
            for left, right in zip(lefts, rights, strict=True)
        )

    def _strip_winners(self) -> Winners:
        from twinlens.matching.kernels.winners import winners_of_rows

        winners = Winners.empty(self.left.shape, self.rivals)
        rows = self._aggregated()
        fit, limits = FITS[self.fit], box.limits(np.float64)

        def work(start: int, stop: int) -> None:
            winners_of_rows(
                rows(start, stop).reshape(-1),
                self.depth,
                self.low,
                self.count,
                fit,
                limits,
                *winners.rows(start, stop),
            )

        in_strips(work, len(self.left), self.support.strip, self.threads)
        return winners

    def _aggregated(self) -> Rows:
        """The costs after aggregation; +inf where there is no candidate."""
        height = len(self.left)
        halo = self.support.halo * (self.side // 2)
        sources = [self._source(side) for side in self.sides]
        left, right = levels(self.left, self.right)

        def rows(start: int, stop: int) -> Volume:
            first, last = max(0, start - halo), min(height, stop + halo)
            volumes = tuple(source(first, last) for source in sources)
            if self.support.masked:
                for volume in volumes:
                    box.blank(volume, self.low, self.count)
            costs = volumes[0]
            if self.support.aggregate:
                strip = Strip(
                    volumes,
                    first,
                    start,
                    stop,
                    left,
                    right,
                    self.low,
                    self.side,
                    self.cost.growth,
                    self.options,
                )
                costs = self.support.aggregate(strip)
            box.blank(costs, self.low, self.count)
            return costs

        return rows

    def _source(self, side: int) -> Rows:
        """The costs of windows of this side, before aggregation."""
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

    @functools.cached_property
    def _descriptors(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """The descriptors (H, W, C) of both images, computed once and never of mirrored images."""
        model = descriptor_model(self.options.cost) or ""
        step = -1 if self.mirrored else 1
        left = descriptors(model, self.left[:, ::step])[:, ::step]
        right = descriptors(model, self.right[:, ::step])[:, ::step]
        return left, right

    def _sweeps(self) -> tuple[Sweeps, float]:
        """The semi-global search of the window costs or of the aggregated ones, and the gain of its costs."""
        boxes = self._boxes(self.side) if self._in_boxes else ()
        whole_numbers = bool(boxes) and np.dtype(boxes[0].numbers.scores).kind != "f"
        side, parts = (self.side, 1) if boxes else (self.sides[0], self.support.parts)
        largest = largest_cost(
            self.cost, self.left, self.right, side, self.options.census_window
        )
        gain, penalties = Penalties.scaled(
            self.options.penalties, largest * parts, whole_numbers
        )
        shape = *self.left.shape, self.depth
        if boxes:
            offset = self.cost.offset * gain
            costs = quantised(boxes, gain, offset, penalties, self.threads)
        else:
            rows = self._aggregated()

            def scaled(start: int, stop: int) -> Volume:
                whole = np.rint(np.maximum(rows(start, stop), 0) * gain)
                return np.minimum(whole, penalties.top)

            costs = stored(shape, penalties, scaled, self.support.strip, self.threads)
        sweeps = Sweeps(
            costs, shape, self.paths, penalties, self.low, self.count, self.fit
        )
        return sweeps, gain

    def _path_costs(
        self, start: int, stop: int, keep: Callable[[int, Volume], None]
    ) -> None:
        """`costs` of a semi-global search: the mean over its paths, in the units of the costs before scaling."""
        sweeps, gain = self._sweeps()

        def on_row(y: int, sums: NDArray[np.uint16]) -> None:
            if start <= y < stop:
                costs = sums[None] / (gain * self.paths * self._unit)
                box.blank(costs, self.low, self.count)
                keep(y, costs)

        sweeps.winners(self.threads, rivals=False, on_row=on_row)
