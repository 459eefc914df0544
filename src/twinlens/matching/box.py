"""Winner-take-all with a fixed square window: prepares memory for the kernel and shares the rows between threads."""

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.matching.costs import Cost, numbers
from twinlens.matching.images import Disparity, Image, extended
from twinlens.matching.passes import Pass, filling, winning
from twinlens.matching.strips import in_strips, strip_rows

CACHE_LINE = 64
FITS = {"none": 0, "v": 1, "parabola": 2}
WINNERS, RIVALS, VOLUME, WHOLE = 0, 1, 2, 3
NOTHING, TOTALS, DEVIATIONS, NORMS, SHARES = 0, 1, 2, 3, 4
STATISTICS = {
    "sum": (NOTHING, NOTHING),
    "zssd": (TOTALS, TOTALS),
    "zncc": (DEVIATIONS, DEVIATIONS),
    "zncc_of_right": (TOTALS, DEVIATIONS),
    "ncc": (NORMS, NORMS),
    "jaccard": (SHARES, SHARES),
}
"""What a scoring takes of the windows of the left image and of the right one; see `kernels.windows`."""
GUARD, SLOTS = 64, 4
ROUNDING = 2.0**-40  # of the largest cost: floats that differ by less are equal


@dataclass(frozen=True)
class Winners:
    """Disparity (H, W) float32, +inf where there is no candidate; its cost in the kernel's own numbers; its index.

    index (H, W) int32 is the disparity before the sub-pixel fit, and (1, 1) where no one asked for it.
    """

    disparity: Disparity
    cost: NDArray[Any]
    index: NDArray[np.int32]


def aligned_zeros(count: int, dtype: Any) -> NDArray[Any]:
    """Zeros that begin on a cache line, so that no load of whole lanes straddles two."""
    itemsize = np.dtype(dtype).itemsize
    raw = np.zeros(count * itemsize + CACHE_LINE, np.uint8)
    start = -raw.ctypes.data % CACHE_LINE
    return raw[start : start + count * itemsize].view(dtype)


def largest(dtype: Any) -> float:
    """What stands for no cost at all: +inf, or an integer dtype's largest number, which no sum reaches."""
    return np.inf if np.dtype(dtype).kind == "f" else int(np.iinfo(dtype).max)


def smallest(dtype: Any) -> float:
    """What no cost lies below."""
    return -np.inf if np.dtype(dtype).kind == "f" else 0


class BoxMatch:
    """One cost of one pair over one window, ready to be searched."""

    def __init__(self, left: Image, right: Image, cost: Cost, side: int, low: int, high: int, threads: int) -> None:
        """Search disparities low..high-1; left and right are uint8, uint16, uint32, uint64 or float64, (H, W)."""
        width = left.shape[1]
        self.shape, self.cost, self.side, self.threads = left.shape, cost, side, threads
        self.low, self.high = max(low, 1 - width), min(high, width)
        self.sums, self.scores = numbers(cost, left.dtype, side)
        self.floats = left.dtype.kind == "f"
        self.left, self.right = _settled(left, right, cost) if self.floats else (left, right)
        self.slack = self._slack() if self.floats else 0.0
        self.rows = strip_rows(left.dtype, self.shape[0], threads)
        bits = 8 * np.dtype(self.sums).itemsize
        candidates = max(self.high - self.low, 0)
        self.winning, self.filling = tuple(winning(candidates, bits)), tuple(filling(candidates, bits))

    def _slack(self) -> float:
        """By how much sums of floats that are equal may differ."""
        if self.cost.scoring in ("zncc", "ncc", "jaccard"):
            return ROUNDING
        span = max(float(np.abs(self.left).max()), float(np.abs(self.right).max())) * 2
        area = self.side**2
        return (
            ROUNDING
            * {"absolute": area * span, "square": area * span**2}[self.cost.term]
            * (area if self.cost.scoring == "zssd" else 1)
        )

    @property
    def depth(self) -> int:
        """How many candidates a cost volume holds for each pixel: those of the range, and what fills the last lanes."""
        last = self.filling[-1]
        return last.first + last.n

    def winners(self, fit: str, *, costs: bool = True) -> Winners:
        """The candidate of lowest cost at each pixel, of equal ones the smallest disparity, with sub-pixel `fit`.

        Where no one asks for the costs, they may lack a factor that is the same for all candidates of a pixel, and
        there is no index.
        """
        best = np.full(self.shape, largest(self.scores), self.scores)
        disparity = np.full(self.shape, np.inf, np.float32)
        index = np.zeros(self.shape if costs else (1, 1), np.int32)
        if self._correlates and not costs:
            self._correlate(best, disparity, fit)
        else:
            scoring = self.cost.scoring if costs else self._short
            self._search(best, disparity, index, fit, WINNERS, scoring)
        return Winners(disparity, best, index)

    @property
    def _short(self) -> str:
        """The scoring with which whole numbers find the winners soonest."""
        if self.cost.scoring != "zncc" or self.floats:
            return self.cost.scoring
        return "zncc_of_right"

    def rivals(self, winners: Winners) -> NDArray[Any]:
        """The lowest cost among candidates at least two away from the winner; the largest number where none is."""
        best = np.full(self.shape, largest(self.scores), self.scores)
        self._search(best, winners.disparity, winners.index, "none", RIVALS, self.cost.scoring)
        return best

    def _search(
        self, best: NDArray[Any], disparity: Disparity, index: NDArray[Any], fit: str, mode: int, scoring: str
    ) -> None:
        if self.low >= self.high:
            return
        from twinlens.matching.kernels.slide import slide_kernel

        unused = np.zeros(1, np.float32), (0, 0, 0), np.zeros(3, np.float32)

        def work(y0: int, y1: int) -> None:
            maps = best[y0:y1], disparity[y0:y1], index[y0:y1] if len(index) == len(best) else index
            images = self._laid_out(y0, y1)
            for part in self.winning:
                kernel = slide_kernel(self._term, scoring, part.n, mode)
                kernel(*self._arguments(images, part, scoring), FITS[fit], *self._scratch(part.n), *maps, *unused)

        in_strips(work, self.shape[0], self.rows, self.threads)

    @property
    def _correlates(self) -> bool:
        """Has this ZNCC of bytes a kernel of its own? Totals of its windows fit 15 bits."""
        return self.cost.scoring == "zncc" and self._term == "product8" and self.side**2 * 255 < 1 << 15

    def _correlate(self, best: NDArray[Any], disparity: Disparity, fit: str) -> None:
        """What `_search` finds for winners, without their costs: by the kernel that knows no other measure."""
        if self.low >= self.high:
            return
        from twinlens.matching.kernels.correlate import correlation_kernel, room

        centre, width = _centre(self.left), self.shape[1]

        def work(y0: int, y1: int) -> None:
            images = self._laid_out(y0, y1)
            for part in self.winning:
                sums, fence = aligned_zeros(room(width, part.n), np.int32), aligned_zeros(4 * part.n, np.int32)
                fence[:] = np.iinfo(np.int32).min
                fence[part.n : 3 * part.n] = np.iinfo(np.int32).max
                area = np.array([self.side**2], np.int32)
                scratch = area, FITS[fit], sums, fence
                kernel = correlation_kernel(part.n)
                kernel(*self._places(images, part), *centre, *scratch, best[y0:y1], disparity[y0:y1])

        in_strips(work, self.shape[0], self.rows, self.threads)

    def fill(self, volume: NDArray[Any], y0: int, gain: float, offset: float, blank: float | None) -> None:
        """Write the rows from y0 on of the cost volume, (rows, W, depth), as cost * gain + offset.

        Candidates without a partner in the right image become `blank`; None leaves them what edge-continued images
        give. float16 and integer volumes are for the caller to keep in range.
        """
        from twinlens.matching.kernels.slide import slide_kernel

        whole = gain == 1.0 and int(offset) == 0 and volume.dtype.kind == "u" and np.dtype(self.scores).kind == "u"
        mode = WHOLE if whole else VOLUME
        maps = np.empty((len(volume), self.shape[1]), self.scores), np.empty((1, 1), np.float32)
        kind = np.float64 if np.dtype(self.scores).itemsize > 4 else np.float32
        values = np.array([gain, offset, 0 if blank is None else blank], kind)
        rows = slice(y0, y0 + len(volume) + 2 * (self.side // 2))
        images = self._whole[0][rows], self._whole[1][rows]
        for part in self.filling:
            kernel = slide_kernel(self._term, self.cost.scoring, part.n, mode)
            target = self.depth, part.first, int(blank is not None)
            arguments = self._arguments(images, part, self.cost.scoring), (0, *self._scratch(part.n))
            kernel(*arguments[0], *arguments[1], *maps, np.zeros((1, 1), np.int32), volume.reshape(-1), target, values)

    @property
    def _term(self) -> str:
        """The pixel term; bytes have kernels of their own, as long as the sums are narrow."""
        narrow = {"product": np.int32, "absolute": np.uint16}.get(self.cost.term)
        return f"{self.cost.term}8" if self.left.dtype == np.uint8 and self.sums == narrow else self.cost.term

    def _laid_out(self, y0: int, y1: int) -> tuple[Image, Image]:
        """The rows that windows of y0..y1 look at: left, and right reversed, both continued by their edges."""
        radius, width = self.side // 2, self.shape[1]
        rows, lanes = (y0 - radius, y1 + radius), self._last - self.low
        left = extended(self.left, rows, (-radius, width + radius))
        # Seen from the other side, column c is W - 1 - c.
        columns = (-radius + self.low, width + radius + self.low + lanes)
        return left, extended(self.right[:, ::-1], rows, columns)

    @functools.cached_property
    def _whole(self) -> tuple[Image, Image]:
        """All rows: volumes are filled some rows at a time, too few to lay them out anew."""
        return self._laid_out(0, self.shape[0])

    @property
    def _last(self) -> int:
        """The largest disparity that any lane holds."""
        held = max(part.first + part.n for part in (*self.winning, *self.filling))
        return int(self.low + held - 1)

    def _scratch(self, n: int) -> tuple[Any, ...]:
        """The slack, the kernel's column sums, its room for some pixels' costs, and the fence around lanes."""
        columns = aligned_zeros((self.shape[1] + 2 * (self.side // 2) + self.side) * n, self.sums)
        fence = aligned_zeros(4 * n, self.scores)
        fence[:] = largest(self.scores)
        fence[n : 3 * n] = smallest(self.scores)
        return np.full(1, self.slack, self.scores), columns, aligned_zeros(SLOTS * n + 2 * GUARD, self.scores), fence

    def _places(self, images: tuple[Image, Image], part: Pass) -> tuple[Any, ...]:
        """The images of one strip, how their rows lie, and what one pass searches; see `kernels.slide.slide_kernel`."""
        left, right = images
        radius, width, first = self.side // 2, self.shape[1], self.low + part.first
        layout = (left.shape[1], right.shape[1], width - 1 + 2 * radius + part.first)
        spans = (radius, self.side**2, first, self.low - first, self.high - first, part.begin, part.end)
        return left.ravel(), right.ravel(), layout, spans

    def _arguments(self, images: tuple[Image, Image], part: Pass, scoring: str) -> tuple[Any, ...]:
        """What `kernels.slide.slide_kernel` reads in one pass over one strip."""
        left = images[0]
        # Sums of 8-bit squares fit 32 bits, and so does what is made of those of small windows, or float64; 16-bit
        # ones need all of 64.
        small = left.dtype == np.uint8 and self.side < 180
        kind = np.float64 if self.floats else (np.int32 if small else np.int64)
        wide = np.int32 if small and self.side < 20 else (np.float64 if small or self.floats else np.int64)
        modes = STATISTICS[scoring]
        states = tuple(
            np.zeros((3, image.shape[1] if mode else 1), kind) for image, mode in zip(images, modes, strict=True)
        )
        equals = tuple(np.zeros(image.shape[1] if self.floats else 1, np.int64) for image in images)
        return *self._places(images, part), modes, np.array([self.side**2], wide), *states, equals


def _centre(left: Image) -> tuple[int, bool]:
    """What `kernels.quads` takes from the left image's bytes, 127 or 128, and whether a pixel is then out of range.

    Of the two, the one that leaves fewer such pixels: each costs a second step.
    """
    black, white = np.count_nonzero(left == 0), np.count_nonzero(left == 255)
    return (128, bool(black)) if black <= white else (127, bool(white))


def _settled(left: Image, right: Image, cost: Cost) -> tuple[Image, Image]:
    """Float images whose sums lose as little as can be.

    Absolute differences: rounded to a grid of 2^-40 of the largest value, on which all sums are exact. Scores that are
    blind to an offset: less the left image's mean.
    """
    if cost.scoring in ("zncc", "zssd"):
        return left - left.mean(), right - left.mean()
    top = max(float(np.abs(left).max()), float(np.abs(right).max()))
    if cost.term != "absolute" or top == 0:
        return left, right
    step = 2.0 ** (np.frexp(top)[1] - 40)
    return np.rint(left / step) * step, np.rint(right / step) * step
