"""Winner-take-all with a fixed square window: prepares memory for the kernel and shares the rows between threads."""

import functools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.matching.costs import Cost, numbers
from twinlens.matching.images import Disparity, Image, extended

FLOAT_ROWS = 64  # rounding depends on where a strip begins: float images are always cut in the same places
LANE_COUNTS = (16, 32, 64, 96, 128)
LANE_BITS = 4096
CACHE_LINE = 64
FITS = {"none": 0, "v": 1, "parabola": 2}
WINNERS, RIVALS, VOLUME, WHOLE = 0, 1, 2, 3
SCALES = {"sum": 0, "zssd": 0, "zncc": 1, "ncc": 2, "jaccard": 3}


def cpu_count() -> int:
    """How many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def in_strips(work: Callable[[int, int], None], height: int, rows: int, threads: int) -> None:
    """work(y0, y1) for every strip of at most `rows` rows, on as many threads."""
    strips = [(y, min(y + rows, height)) for y in range(0, height, rows)]
    if threads <= 1 or len(strips) == 1:
        for strip in strips:
            work(*strip)
        return
    with ThreadPoolExecutor(min(threads, len(strips))) as pool:
        for done in [pool.submit(work, *strip) for strip in strips]:
            done.result()


def strip_rows(dtype: np.dtype[Any], height: int, threads: int) -> int:
    """Rows a strip has: an equal share for each thread, or a fixed number where sums round."""
    return FLOAT_ROWS if dtype.kind == "f" else -(-height // max(threads, 1))


@dataclass(frozen=True)
class Passes:
    """How a disparity range is covered by lanes: `count` passes of n lanes, neighbours sharing two of them.

    The two shared lanes let each pass see the neighbours of every cost that may win in it.
    """

    n: int
    count: int

    @staticmethod
    def covering(candidates: int, bits: int) -> "Passes":
        """The fewest lanes in all, for numbers of so many bits."""

        def passes(n: int) -> Passes:
            return Passes(n, 1 if candidates <= n else -(-(candidates - 2) // (n - 2)))

        allowed = [passes(n) for n in LANE_COUNTS if n * bits <= LANE_BITS]
        return min(allowed, key=lambda p: (p.n * p.count, p.count))

    def own(self, index: int) -> tuple[int, int]:
        """The lanes that may win in this pass."""
        return (0 if index == 0 else 1, self.n if index == self.count - 1 else self.n - 1)

    def first(self, index: int) -> int:
        """The candidate that lane 0 of this pass holds, counted from the range's first."""
        return index * (self.n - 2)


@dataclass(frozen=True)
class Winners:
    """Disparity (H, W) float32, +inf where there is no candidate, and its cost in the kernel's own numbers."""

    disparity: Disparity
    cost: NDArray[Any]


def aligned_zeros(count: int, dtype: Any) -> NDArray[Any]:
    """Zeros that begin on a cache line, so that no load of whole lanes straddles two."""
    itemsize = np.dtype(dtype).itemsize
    raw = np.zeros(count * itemsize + CACHE_LINE, np.uint8)
    start = -raw.ctypes.data % CACHE_LINE
    return raw[start : start + count * itemsize].view(dtype)


def largest(dtype: Any) -> float:
    """What stands for no cost at all: +inf, or an integer dtype's largest number, which no sum reaches."""
    return np.inf if np.dtype(dtype).kind == "f" else int(np.iinfo(dtype).max)


class BoxMatch:
    """One cost of one pair over one window, ready to be searched."""

    def __init__(self, left: Image, right: Image, cost: Cost, side: int, low: int, high: int, threads: int) -> None:
        """Search disparities low..high-1; left and right are uint8, uint16, uint32, uint64 or float64, (H, W)."""
        width = left.shape[1]
        self.shape, self.cost, self.side, self.threads = left.shape, cost, side, threads
        self.low, self.high = max(low, 1 - width), min(high, width)
        self.sums, self.scores = numbers(cost, left.dtype, side)
        if left.dtype.kind == "f" and cost.scoring in ("zncc", "zssd"):
            left, right = left - left.mean(), right - left.mean()
        if self.low < self.high:
            self._lay_out(left, right)

    def _lay_out(self, left: Image, right: Image) -> None:
        height, width = self.shape
        radius = self.side // 2
        self.passes = Passes.covering(self.high - self.low, 8 * np.dtype(self.sums).itemsize)
        last = self.low + self.passes.first(self.passes.count - 1) + self.passes.n - 1
        rows = (-radius, height + radius)
        self.left = extended(left, rows, (-radius, width + radius))
        self.right = extended(right, rows, (-radius - last, width + radius - self.low))[:, ::-1].copy()
        self.rows = strip_rows(left.dtype, height, self.threads)
        mirrored = extended(right[:, ::-1], rows, (-radius, width + radius))
        self.right_stats = self._stats(mirrored, max(-self.low, 0), max(last, 0), SCALES[self.cost.scoring])

    @functools.cached_property
    def left_stats(self) -> tuple[Image, Image]:
        """Window sums and scales of the left image."""
        return self._stats(self.left, 0, 0, SCALES[self.cost.scoring])

    def _stats(self, padded: Image, before: int, after: int, mode: int) -> tuple[Image, Image]:
        """Window sums and scales (H, before + W + after), zero outside the image; empty where no score needs them."""
        if self.cost.scoring == "sum":
            return np.zeros((1, 1), self.sums), np.zeros((1, 1), self.scores)
        from twinlens.matching.kernels.windows import FLAT, window_stats

        integers = padded.dtype.kind != "f"
        shape = (self.shape[0], before + self.shape[1] + after)
        totals, scales = np.zeros(shape, self.sums), np.zeros(shape if mode else (1, 1), self.scores)
        # Sums of 8-bit squares fit 32 bits, and float64 what is made of them; 16-bit ones need all of 64.
        small = padded.dtype == np.uint8 and self.side < 180
        kind = (np.int32 if small else np.int64) if integers else np.float64
        area = np.float64(self.side**2) if small or not integers else np.int64(self.side**2)
        flat, border = 0.0 if integers else FLAT, self.side - 1

        def work(y0: int, y1: int) -> None:
            columns = np.zeros((3, padded.shape[1]), kind)
            rows = padded[y0 : y1 + border]
            window_stats(rows, self.side // 2, mode, flat, area, columns, before, totals[y0:y1], scales[y0:y1])

        in_strips(work, self.shape[0], self.rows, self.threads)
        return totals, scales

    @property
    def depth(self) -> int:
        """How many candidates a cost volume holds for each pixel: those of the range, and what fills the last lanes."""
        return self.passes.first(self.passes.count - 1) + self.passes.n

    def winners(self, fit: str, *, costs: bool = True) -> Winners:
        """The candidate of lowest cost at each pixel, of equal ones the smallest disparity, with sub-pixel `fit`.

        Where no one asks for the costs, they may lack a factor that is the same for all candidates of a pixel.
        """
        best = np.full(self.shape, largest(self.scores), self.scores)
        disparity = np.full(self.shape, np.inf, np.float32)
        if self.low < self.high:
            self._search(best, disparity, fit, WINNERS, self.cost.scoring if costs else self._short)
        return Winners(disparity, best)

    @property
    def _short(self) -> str:
        """The scoring with which whole numbers find the winners soonest."""
        if self.cost.scoring != "zncc" or self.left.dtype.kind == "f":
            return self.cost.scoring
        fits = self._term == "product8" and self.side**2 * 255 < 1 << 15
        return "zncc_of_weighted" if fits else "zncc_of_right"

    def rivals(self, disparity: Disparity) -> NDArray[Any]:
        """The lowest cost among candidates at least two away from the winner; the largest number where none is."""
        best = np.full(self.shape, largest(self.scores), self.scores)
        self._search(best, disparity, "none", RIVALS, self.cost.scoring)
        return best

    def _search(self, best: NDArray[Any], disparity: Disparity, fit: str, mode: int, scoring: str) -> None:
        if self.low >= self.high:
            return
        from twinlens.matching.kernels.slide import slide_kernel

        kernel = slide_kernel(self._term, scoring, self.passes.n, mode)
        unused = np.zeros(1, np.float32), (0, 0, 0), np.zeros(3, np.float32)
        # Products of the left image times the window's area come at the price of products.
        left = self.left.astype(np.int16) * np.int16(self.side**2) if scoring == "zncc_of_weighted" else self.left
        stats = self.left_stats if scoring == self.cost.scoring else self._stats(self.left, 0, 0, 0)

        def work(y0: int, y1: int) -> None:
            maps = best[y0:y1], disparity[y0:y1]
            for index in range(self.passes.count):
                kernel(*self._arguments(left, stats, y0, y1, index), FITS[fit], *self._scratch(), *maps, *unused)

        in_strips(work, self.shape[0], self.rows, self.threads)

    def fill(self, volume: NDArray[Any], y0: int, gain: float, offset: float, blank: float | None) -> None:
        """Write the rows from y0 on of the cost volume, (rows, W, depth), as cost * gain + offset.

        Candidates without a partner in the right image become `blank`; None leaves them what edge-continued images
        give. float16 and integer volumes are for the caller to keep in range.
        """
        from twinlens.matching.kernels.slide import slide_kernel

        whole = gain == 1.0 and int(offset) == 0 and volume.dtype.kind == "u" and np.dtype(self.scores).kind == "u"
        kernel = slide_kernel(self._term, self.cost.scoring, self.passes.n, WHOLE if whole else VOLUME)
        maps = np.empty((len(volume), self.shape[1]), self.scores), np.empty((1, 1), np.float32)
        kind = np.float64 if np.dtype(self.scores).itemsize > 4 else np.float32
        values = np.array([gain, offset, 0 if blank is None else blank], kind)
        for index in range(self.passes.count):
            target = self.depth, self.passes.first(index), int(blank is not None)
            arguments = self._arguments(self.left, self.left_stats, y0, y0 + len(volume), index)
            kernel(*arguments, 0, *self._scratch(), *maps, volume.reshape(-1), target, values)

    @property
    def _term(self) -> str:
        fits = self.cost.term == "product" and self.left.dtype == np.uint8 and self.sums == np.int32
        return "product8" if fits else self.cost.term

    def _scratch(self) -> tuple[NDArray[Any], NDArray[np.uint8], NDArray[Any]]:
        """The kernel's column sums, its room for two rows of the right image, and for one pixel's costs."""
        columns = aligned_zeros((self.left.shape[1] + self.side) * self.passes.n, self.sums)
        return columns, np.zeros(2 * self.right.shape[1], np.uint8), aligned_zeros(self.passes.n, self.scores)

    def _arguments(self, left: Image, left_stats: tuple[Image, Image], y0: int, y1: int, index: int) -> tuple[Any, ...]:
        """What the kernel reads in one pass over one strip; see `kernels.slide.winner_kernel`."""
        radius, width = self.side // 2, self.shape[1]
        first = self.low + self.passes.first(index)
        rows = slice(y0, y1 + 2 * radius)
        right_start = width - 1 + 2 * radius + first - self.low
        stride = self.right_stats[0].shape[1]
        layout = (self.left.shape[1], self.right.shape[1], right_start, stride, width - 1 + first + max(-self.low, 0))
        spans = (radius, self.side**2, first, self.low - first, self.high - first, *self.passes.own(index))
        lefts = tuple(array[y0:y1].ravel() for array in left_stats)
        rights = tuple(array[y0:y1].ravel() for array in self.right_stats)
        return left[rows].ravel(), self.right[rows].ravel(), layout, lefts, rights, spans
