"""One search of one image pair: cost, support and optimisation put together, strip by strip."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from twinlens.matching.box import FITS, BoxMatch, Chosen, Volume, blank, in_lanes, limits
from twinlens.matching.costs import Cost, largest_cost
from twinlens.matching.images import Image, levels
from twinlens.matching.semiglobal import Costs as SweepCosts
from twinlens.matching.semiglobal import Penalties, Sweeps, quantised, scaled, stored
from twinlens.matching.strips import in_strips
from twinlens.matching.supports import Scene, Settings, Strip, Support
from twinlens.matching.transforms import census_images, rank_image
from twinlens.matching.volume import BirchfieldTomasi, BoxCosts, Costs, ZeroMeanAbsolute

STRIP_ROWS = 16  # of a cost volume that is held at a time, without its support's halo


@dataclass(frozen=True)
class Search:
    """One search; the fields are those of `StereoMatcher`, looked up in the tables and checked."""

    cost: Cost
    side: int
    low: int
    count: int
    descriptor: int
    support: Support
    settings: Settings
    paths: int
    penalties: tuple[float, float]
    fit: str
    rivals: bool
    threads: int

    @property
    def sides(self) -> tuple[int, ...]:
        """The windows whose costs the support gathers, the widest first."""
        return (1,) if self.support.pixelwise else self.support.windows(self.side)


def search(task: Search, left: Image, right: Image) -> Chosen:
    """The winner at every pixel of the left image; both images are grey, in a working dtype."""
    width = left.shape[1]
    low, high = max(task.low, 1 - width), min(task.low + task.count, width)
    if low >= high:
        return Chosen.empty(left.shape)
    if task.support.halo(task.side) == 0 and task.cost.in_lanes:
        boxes = _boxes(task, left, right, task.side, low, high)
        if task.paths:
            return _semiglobal(task, left, right, boxes)
        if len(boxes) == 1:
            return _normalised(task, boxes[0].winners(task.fit, costs=task.rivals))
    scene = Scene(*levels(left, right), task.side, low, task.settings, task.cost.growth)
    gather = _gatherer(task, tuple(_costs(task, left, right, side, low, high) for side in task.sides), scene, high)
    return (_smoothed if task.paths else _local)(task, left, right, gather, low, high)


def _described(task: Search, image: Image) -> list[Image]:
    if task.cost.transform == "census":
        return census_images(image, task.descriptor)
    return [rank_image(image, task.descriptor)] if task.cost.transform == "rank" else [image]


def _boxes(task: Search, left: Image, right: Image, side: int, low: int, high: int) -> tuple[BoxMatch, ...]:
    pairs = zip(_described(task, left), _described(task, right), strict=True)
    return tuple(BoxMatch(one, other, task.cost, side, low, high, task.threads) for one, other in pairs)


def _normalised(task: Search, found: Chosen) -> Chosen:
    """The kernel's scores as costs; similarities that differ by rounding alone become equal."""
    if not task.cost.offset:
        return found
    return Chosen(found.disparity, *(np.round(scores + task.cost.offset, 6) for scores in (found.cost, found.rival)))


def _costs(task: Search, left: Image, right: Image, side: int, low: int, high: int) -> Costs:
    """Costs of single pixels or of windows, as the support takes them."""
    if task.cost.term == "birchfield-tomasi":
        return BirchfieldTomasi(left, right, side, low, in_lanes(high - low))
    if task.cost.term == "zero-mean absolute":
        return ZeroMeanAbsolute(left, right, side, low, in_lanes(high - low))
    return BoxCosts(_boxes(task, left, right, side, low, high), task.cost.offset)


Gather = Callable[[int, int], Volume]
"""gather(start, stop): the rows start..stop of the volume of gathered costs, with a depth of whole LANES."""


def _gatherer(task: Search, costs: tuple[Costs, ...], scene: Scene, high: int) -> Gather:
    height, width = scene.left.shape
    halo, depth = task.support.halo(task.side), in_lanes(high - scene.low)

    def gather(start: int, stop: int) -> Volume:
        first, last = max(0, start - halo), min(height, stop + halo)
        volumes = tuple(np.empty((last - first, width, depth), np.float64) for _ in costs)
        for each, volume in zip(costs, volumes, strict=True):
            each.fill(volume, first)
            if task.support.masked:
                blank(volume, scene.low, high - scene.low)
        return task.support.gather(Strip(volumes[0], first, start, stop, volumes[1:]), scene)

    return gather


def _local(task: Search, left: Image, _right: Image, gather: Gather, low: int, high: int) -> Chosen:
    from twinlens.matching.kernels.settle import settle_rows

    chosen = Chosen.empty(left.shape, task.rivals)

    def work(start: int, stop: int) -> None:
        volume = gather(start, stop)
        blank(volume, low, high - low)
        settings = volume.shape[2], low, high - low, FITS[task.fit], limits(np.float64)
        settle_rows(volume.reshape(-1), *settings, *chosen.rows(start, stop))

    in_strips(work, left.shape[0], STRIP_ROWS, task.threads)
    return chosen


def _span(left: Image, right: Image) -> float:
    """The largest difference that two pixels of the pair can have; 1 where all are equal."""
    if left.dtype.kind == "u":
        return float(np.iinfo(left.dtype).max)
    return float(max(left.max(), right.max())) - float(min(left.min(), right.min())) or 1.0


def _full(task: Search, left: Image, right: Image, side: int) -> float:
    return largest_cost(task.cost, _span(left, right), side, task.descriptor**2 - 1)


def _semiglobal(task: Search, left: Image, right: Image, boxes: tuple[BoxMatch, ...]) -> Chosen:
    whole = np.dtype(boxes[0].numbers.scores).kind != "f"
    gain, top = scaled(_full(task, left, right, task.side), whole, task.penalties[1])
    penalties = Penalties.parts(task.penalties, top)
    costs = quantised(boxes, gain, task.cost.offset * gain, penalties, task.threads)
    return _optimised(task, costs, left, penalties, boxes[0].low, boxes[0].high)


def _smoothed(task: Search, left: Image, right: Image, gather: Gather, low: int, high: int) -> Chosen:
    """The same from gathered costs, for any support."""
    gain, top = scaled(_full(task, left, right, task.sides[0]) * task.support.parts, False, task.penalties[1])
    penalties = Penalties.parts(task.penalties, top)
    volume = np.empty((*left.shape, in_lanes(high - low)), penalties.dtype)

    def work(start: int, stop: int) -> None:
        part = gather(start, stop)
        blank(part, low, high - low)
        volume[start:stop] = np.minimum(np.rint(np.maximum(part, 0) * gain), top)

    in_strips(work, left.shape[0], STRIP_ROWS, task.threads)
    return _optimised(task, stored(volume), left, penalties, low, high)


def _optimised(task: Search, costs: SweepCosts, left: Image, penalties: Penalties, low: int, high: int) -> Chosen:
    shape = *left.shape, in_lanes(high - low)
    sweeps = Sweeps(costs, shape, task.paths, penalties, low, high - low, task.fit)
    return sweeps.chosen(task.threads, rivals=task.rivals)
