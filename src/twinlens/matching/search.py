"""One search of one image pair: costs, support and optimisation put together, strip by strip."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from twinlens.matching.box import FITS, BoxMatch, largest
from twinlens.matching.costs import Cost, largest_cost
from twinlens.matching.images import Image
from twinlens.matching.semiglobal import LANES, Penalties, Sweeps, quantised, scaled, stored
from twinlens.matching.semiglobal import Costs as Volumes
from twinlens.matching.strips import in_strips
from twinlens.matching.supports import Scene, Settings, Strip, Support, levels
from twinlens.matching.transforms import census_images, rank_image
from twinlens.matching.volume import BirchfieldTomasi, BoxCosts, Chosen, Costs, Volume, ZeroMeanAbsolute

STRIP_ROWS = 16  # of a cost volume that is held at a time, beside its support's halo


@dataclass(frozen=True)
class Search:
    """What to look for and how; the fields are those of `StereoMatcher`, looked up and resolved."""

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
            return _fastest(task, boxes[0])
    costs = _costs(task, left, right, low, high)
    gather = _gatherer(task, costs, Scene(*levels(left, right), task.side, low, task.settings, task.cost.growth), low)
    return (
        _smoothed(task, left, right, gather, costs, low, high) if task.paths else _local(task, left, gather, low, high)
    )


def _described(task: Search, image: Image) -> list[Image]:
    if task.cost.transform == "census":
        return census_images(image, task.descriptor)
    return [rank_image(image, task.descriptor)] if task.cost.transform == "rank" else [image]


def _boxes(task: Search, left: Image, right: Image, side: int, low: int, high: int) -> tuple[BoxMatch, ...]:
    pairs = zip(_described(task, left), _described(task, right), strict=True)
    return tuple(BoxMatch(one, other, task.cost, side, low, high, task.threads) for one, other in pairs)


def _fastest(task: Search, box: BoxMatch) -> Chosen:
    found = box.winners(task.fit, costs=task.rivals)
    nothing = np.empty((0, 0))
    if not task.rivals:
        return Chosen(found.disparity, nothing, nothing)
    rivals = box.rivals(found)
    cost, rival = (
        np.where(values == largest(box.scores), np.inf, _settled_scores(values, task.cost))
        for values in (found.cost, rivals)
    )
    return Chosen(found.disparity, cost, rival)


def _settled_scores(values: Volume, cost: Cost) -> Volume:
    """The kernel's scores as costs in float64; similarities that differ by rounding alone become equal."""
    costs = values.astype(np.float64) + cost.offset
    return np.round(costs, 6) if cost.offset else costs


def _sides(task: Search) -> tuple[int, ...]:
    """The windows whose costs the support gathers, the widest first."""
    return (1,) if task.support.pixelwise else task.support.windows(task.side)


def _costs(task: Search, left: Image, right: Image, low: int, high: int) -> tuple[Costs, ...]:
    """Costs of single pixels or of windows, as the support wants them."""
    return tuple(_costs_of(task, left, right, side, low, high) for side in _sides(task))


def _costs_of(task: Search, left: Image, right: Image, side: int, low: int, high: int) -> Costs:
    if task.cost.term == "birchfield-tomasi":
        return BirchfieldTomasi(left, right, side, low, high - low)
    if task.cost.term == "zero-mean absolute":
        return ZeroMeanAbsolute(left, right, side, low, high - low)
    return BoxCosts(_boxes(task, left, right, side, low, high), task.cost.offset)


def _gatherer(task: Search, costs: tuple[Costs, ...], scene: Scene, low: int) -> Callable[[int, int], Volume]:
    """gathered(start, stop): the rows start..stop of the volume of gathered costs."""
    height, width = scene.left.shape
    halo = task.support.halo(task.side)

    def gathered(start: int, stop: int) -> Volume:
        first, last = max(0, start - halo), min(height, stop + halo)
        volumes = tuple(np.empty((last - first, width, each.count), np.float64) for each in costs)
        for each, volume in zip(costs, volumes, strict=True):
            each.fill(volume, first)
            if task.support.masked:
                _blank(volume, low)
        return task.support.gather(Strip(volumes[0], first, start, stop, volumes[1:]), scene)

    return gathered


def _blank(volume: Volume, low: int) -> None:
    """Set what has no partner in the image to +inf."""
    width, depth = volume.shape[1:]
    partner = np.arange(width)[:, None] - low - np.arange(depth)[None, :]
    volume[:, (partner < 0) | (partner >= width)] = np.inf


def _local(task: Search, left: Image, gather: Callable[[int, int], Volume], low: int, high: int) -> Chosen:
    from twinlens.matching.kernels.choose import choose

    chosen = Chosen.empty(left.shape)

    def work(start: int, stop: int) -> None:
        rows = slice(start, stop)
        maps = chosen.cost[rows], chosen.rival[rows], chosen.disparity[rows]
        choose(gather(start, stop), low, high - low, FITS[task.fit], *maps)

    in_strips(work, left.shape[0], STRIP_ROWS, task.threads)
    return chosen


def _span(left: Image, right: Image) -> float:
    """The largest difference that two pixels of the pair can have; 1 where all are equal."""
    if left.dtype.kind == "u":
        return float(np.iinfo(left.dtype).max)
    return float(max(left.max(), right.max())) - float(min(left.min(), right.min())) or 1.0


def _semiglobal(task: Search, left: Image, right: Image, boxes: tuple[BoxMatch, ...]) -> Chosen:
    full = largest_cost(task.cost, _span(left, right), task.side, task.descriptor**2 - 1)
    gain, top = scaled(full, np.dtype(boxes[0].scores).kind != "f", task.penalties[1])
    penalties = _penalties(task, top)
    costs = quantised(boxes, gain, task.cost.offset * gain, penalties, task.threads)
    return _optimised(task, costs, left, boxes[0].depth, penalties, boxes[0].low, boxes[0].high)


def _smoothed(
    task: Search,
    left: Image,
    right: Image,
    gather: Callable[[int, int], Volume],
    costs: tuple[Costs, ...],
    low: int,
    high: int,
) -> Chosen:
    """The same from gathered costs, whatever the support."""
    count = costs[0].count
    full = largest_cost(task.cost, _span(left, right), _sides(task)[0], task.descriptor**2 - 1) * task.support.parts
    gain, top = scaled(full, False, task.penalties[1])
    penalties = _penalties(task, top)
    volume = np.full((*left.shape, -(-count // LANES) * LANES), top, penalties.dtype)

    def work(start: int, stop: int) -> None:
        part = gather(start, stop)
        _blank(part, low)
        volume[start:stop, :, :count] = np.minimum(np.rint(np.maximum(part, 0) * gain), top)

    in_strips(work, left.shape[0], STRIP_ROWS, task.threads)
    return _optimised(task, stored(volume), left, count, penalties, low, high)


def _penalties(task: Search, top: int) -> Penalties:
    small, large = (round(part * top) for part in task.penalties)
    return Penalties(small, large, top)


def _optimised(
    task: Search, costs: Volumes, left: Image, candidates: int, penalties: Penalties, low: int, high: int
) -> Chosen:
    shape = *left.shape, -(-candidates // LANES) * LANES
    sweeps = Sweeps(costs, shape, task.paths, penalties, low, high - low, task.fit)
    return sweeps.chosen(task.threads, rivals=task.rivals)
