"""Costs over square windows: prepares memory for the kernels and shares the rows of an image between threads."""

import functools
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.matching.costs import Cost, Numbers, numbers
from twinlens.matching.images import Disparity, Image, extended
from twinlens.matching.kernels import LANES

CACHE_LINE = 64
FITS = {"none": 0, "v": 1, "parabola": 2}
STATISTICS = {"zssd": 0, "jaccard": 0, "zncc": 1, "ncc": 2}
"""The mode of `kernels.windows.window_statistics` for a scoring; "sum" needs none."""
ROUNDING = 2.0**-40
"""Floats that differ by less than this part of the largest cost are equal."""
ROUNDED_DIGITS = 6
"""Decimals of costs that are 1 - similarity."""
FLOAT_ROWS = 64
"""Rows of a strip of float images."""
Volume = NDArray[Any]
Rows = Callable[[int, int], Volume]
"""rows(start, stop): those rows of a cost volume, (stop - start, W, depth), depth a multiple of LANES."""


def in_strips(
    work: Callable[[int, int], None], height: int, rows: int, threads: int
) -> None:
    """Call work(y0, y1) for every strip of at most `rows` rows, on `threads` threads.

    After an error or a KeyboardInterrupt no further strip is started.
    """
    starts = range(0, height, rows)
    strips = starts, [min(y + rows, height) for y in starts]
    if threads > 1 and len(starts) > 1:
        with ThreadPoolExecutor(min(threads, len(starts))) as pool:
            list(pool.map(work, *strips))
    else:
        list(map(work, *strips))


@dataclass(frozen=True)
class Winners:
    """The best candidates, (H, W) each: disparity float32, its cost, and the lowest cost two or more candidates away.

    disparity and the costs are +inf where there is no candidate. Without costs, these have shape (H, 0).
    """

    disparity: Disparity
    cost: NDArray[np.float64]
    rival: NDArray[np.float64]

    @staticmethod
    def empty(shape: tuple[int, ...], costs: bool = True) -> "Winners":
        size = shape if costs else (shape[0], 0)
        return Winners(
            np.full(shape, np.inf, np.float32),
            np.full(size, np.inf),
            np.full(size, np.inf),
        )

    def rows(self, start: int, stop: int) -> tuple[NDArray[Any], ...]:
        """(cost, rival, disparity) of these rows, as `kernels.winners.winners_of_rows` takes them."""
        return self.cost[start:stop], self.rival[start:stop], self.disparity[start:stop]


def in_lanes(count: int) -> int:
    """`count` candidates, rounded up to a multiple of LANES."""
    return -(-count // LANES) * LANES


def limits(dtype: Any, slack: float = 0.0) -> tuple[Any, Any]:
    """(slack, largest number) of a cost dtype, as `kernels.winners.winners_of_row` takes them."""
    kind = np.dtype(dtype).type
    return kind(slack), kind(
        np.inf if np.dtype(dtype).kind == "f" else np.iinfo(dtype).max
    )


def fence(dtype: Any, count: int) -> NDArray[Any]:
    """(depth,): the least cost of each candidate; the largest number from `count` on, where no candidates are."""
    kind = np.dtype(dtype)
    values = np.full(in_lanes(count), -np.inf if kind.kind == "f" else 0, kind)
    values[count:] = limits(dtype)[1]
    return values


def aligned_zeros(count: int, dtype: Any) -> NDArray[Any]:
    """Zeros that begin on a cache line, so that no vector load crosses two lines."""
    itemsize = np.dtype(dtype).itemsize
    raw = np.zeros(count * itemsize + CACHE_LINE, np.uint8)
    start = -raw.ctypes.data % CACHE_LINE
    return raw[start : start + count * itemsize].view(dtype)


class BoxMatch:
    """One cost of one pair over one window; left and right are unsigned integers or float64, (..., H, W)."""

    def __init__(
        self,
        left: Image,
        right: Image,
        cost: Cost,
        side: int,
        low: int,
        high: int,
        threads: int,
    ) -> None:
        """Search disparities low..high-1."""
        height, width = left.shape[-2:]
        self.shape = height, width
        self.cost = cost
        self.side = side
        self.threads = threads
        self.low, self.high = max(low, 1 - width), min(high, width)
        self.count = max(self.high - self.low, 0)
        self.depth = in_lanes(self.count)
        self.numbers: Numbers = numbers(cost, left.dtype, side)
        self.floats = left.dtype.kind == "f"
        if self.floats:
            # Sums of floats depend on where a strip begins, so these images are always cut in the same places.
            self.left, self.right = _conditioned(left, right, cost)
            self.slack = self._slack()
            self.rows = FLOAT_ROWS
        else:
            self.left, self.right = left, right
            self.slack = 0.0
            self.rows = -(-height // max(threads, 1))

    def _slack(self) -> float:
        """The largest rounding difference between two sums that are equal in exact arithmetic."""
        if not self.cost.growth:
            return ROUNDING
        largest = max(float(np.abs(self.left).max()), float(np.abs(self.right).max()))
        span = 2 * largest
        pixel_cost = span**2 if self.cost.term == "square" else span
        return ROUNDING * float(self.side) ** (2 * self.cost.growth) * pixel_cost

    def winners(self, fit: str, *, costs: bool = True) -> Winners:
        """The candidate of lowest cost at each pixel, of equal ones the smallest disparity, with sub-pixel `fit`."""
        winners = Winners.empty(self.shape, costs)
        ends = limits(self.numbers.scores, self.slack)

        def work(y0: int, y1: int) -> None:
            result = FITS[fit], ends, *winners.rows(y0, y1)
            self._slide(self._laid_out(y0, y1), 0, y1 - y0, result)

        if self.count:
            in_strips(work, self.shape[0], self.rows, self.threads)
        if not self.cost.offset:
            return winners
        # The kernels leave the offset out, and similarities that differ by rounding alone become equal.
        return Winners(
            winners.disparity,
            np.round(winners.cost + self.cost.offset, ROUNDED_DIGITS),
            np.round(winners.rival + self.cost.offset, ROUNDED_DIGITS),
        )

    def fill(
        self, volume: Volume, y0: int, gain: float = 1.0, offset: float = 0.0
    ) -> None:
        """Write the rows from y0 on of the cost volume, (rows, W, depth), as cost * gain + offset.

        Candidates without a partner in the right image have the cost of edge-continued images.
        """
        kind = np.result_type(
            self.numbers.scores,
            np.float64 if volume.dtype == np.float64 else np.float32,
        )
        self._slide(
            self._whole,
            y0,
            len(volume),
            (volume.reshape(-1), np.array([gain, offset], kind)),
        )

    def _slide(
        self, images: tuple[Image, Image], top: int, rows: int, result: tuple[Any, ...]
    ) -> None:
        """Run the kernel over the rows from `top` on of padded images."""
        from twinlens.matching.kernels.slide import slide_kernel

        left, right = images
        width, side = self.shape[1], self.side
        span = slice(top, top + rows + side - 1)
        layout = left.shape[-1], right.shape[-1], width + side - 2
        volumes = len(result) == 2
        # A window of one pixel needs no sums of columns, and a volume no scratch for the costs of a row.
        column_count = left.shape[-1] + side if side > 1 else 0
        columns = aligned_zeros(column_count * self.depth, self.numbers.sums)
        costs = aligned_zeros(0 if volumes else width * self.depth, self.numbers.scores)
        statistics = (
            *self._statistics(left[..., span, :]),
            *self._statistics(right[..., span, :]),
        )
        search = self.low, self.count, self.depth
        kernel = slide_kernel(self.cost.term, self.cost.scoring, volumes)
        buffers = (
            columns,
            costs,
            fence(self.numbers.scores, self.depth if volumes else self.count),
        )
        kernel(
            (left.ravel(), right.ravel(), layout),
            (side, top, rows),
            search,
            *buffers,
            statistics,
            result,
        )

    def _statistics(self, image: Image) -> tuple[NDArray[Any], NDArray[Any]]:
        """(totals, scales), flat, of the windows of padded rows."""
        mode = STATISTICS.get(self.cost.scoring)
        if mode is None:
            return np.zeros(1, self.numbers.totals), np.zeros(1, self.numbers.scores)
        from twinlens.matching.kernels.windows import (
            window_statistics,
            zero_flat_scales,
        )

        shape = image.shape[0] - self.side + 1, image.shape[1] - self.side + 1
        totals = np.empty(shape, self.numbers.totals)
        scales = np.empty(shape, self.numbers.scores)
        window_statistics(image, self.side, mode, totals, scales)
        if self.floats and self.cost.scoring in ("zncc", "ncc"):
            zero_flat_scales(image, self.side, self.cost.scoring == "ncc", scales)
        return totals.ravel(), scales.ravel()

    def _laid_out(self, y0: int, y1: int) -> tuple[Image, Image]:
        """The rows that windows of y0..y1 cover: left, and right reversed, both continued by their edges."""
        radius, width = self.side // 2, self.shape[1]
        rows = y0 - radius, y1 + radius
        left = extended(self.left, rows, (-radius, width + radius))
        # In the reversed image, column c is at W - 1 - c.
        columns = self.low - radius, width + radius + self.low + self.depth - 1
        return left, extended(self.right[..., ::-1], rows, columns)

    @functools.cached_property
    def _whole(self) -> tuple[Image, Image]:
        """All rows: volumes are filled a few rows at a time."""
        return self._laid_out(0, self.shape[0])


def box_sums(
    boxes: tuple[BoxMatch, ...], gain: float, offset: float, dtype: Any = np.float64
) -> Rows:
    """The sum of the boxes' costs (a census of many bits has several words), as cost * gain + offset."""

    def rows(start: int, stop: int) -> Volume:
        volume = np.empty((stop - start, boxes[0].shape[1], boxes[0].depth), dtype)
        boxes[0].fill(volume, start, gain, offset)
        for box in boxes[1:]:
            more = np.empty_like(volume)
            box.fill(more, start, gain)
            volume += more
        return volume

    return rows


def blank(volume: Volume, low: int, count: int, value: float = np.inf) -> None:
    """Set candidates (disparity low + j for j < count) without a partner in the image, and later ones, to `value`."""
    width = volume.shape[1]
    volume[..., count:] = value
    # Only columns near the ends of a row have such candidates.
    for columns in (
        slice(0, max(low + count - 1, 0)),
        slice(max(low + width, 0), width),
    ):
        partner = np.arange(width)[columns, None] - low - np.arange(count)
        np.copyto(
            volume[:, columns, :count], value, where=(partner < 0) | (partner >= width)
        )


def _conditioned(left: Image, right: Image, cost: Cost) -> tuple[Image, Image]:
    """Float images with smaller rounding errors in sums: mean removed, or rounded to 2^-40 of the largest value."""
    if cost.scoring in ("zncc", "zssd"):
        return left - left.mean(), right - left.mean()
    # Multiples of one step, 2^-40 of the largest value or less, add up without rounding.
    top = max(float(np.abs(left).max()), float(np.abs(right).max()))
    if cost.term not in ("absolute", "interpolated") or top == 0:
        return left, right
    step = 2.0 ** (np.frexp(top)[1] - 40)
    return np.rint(left / step) * step, np.rint(right / step) * step


def zero_mean_absolute(
    left: Image, right: Image, side: int, low: int, depth: int
) -> Rows:
    """ZSAD over windows, sum |(a - mean a) - (b - mean b)|; the means do not separate: W H D side^2 operations."""

    def means(padded: Image) -> NDArray[np.float64]:
        windows = np.lib.stride_tricks.sliding_window_view(padded, (side, side))
        return np.asarray(windows.mean(axis=(2, 3)))

    def rows(start: int, stop: int) -> Volume:
        from twinlens.matching.kernels.windows import zero_mean_absolute

        radius, width = side // 2, left.shape[1]
        span, last = (start - radius, stop + radius), low + depth - 1
        ours = extended(left, span, (-radius, width + radius)).astype(np.float64)
        theirs = extended(right, span, (-radius - last, width + radius - low)).astype(
            np.float64
        )
        reversed_means, theirs = (
            np.ascontiguousarray(array[:, ::-1]) for array in (means(theirs), theirs)
        )
        volume = np.empty((stop - start, width, depth))
        # Reversed, candidate 0 of the window's first column is at `start`; its window's mean is 2 r columns before.
        places = width + 2 * radius - 1, width - 1
        zero_mean_absolute(
            ours, theirs, means(ours), reversed_means, *places, radius, volume
        )
        return volume

    return rows
