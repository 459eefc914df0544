"""Semi-global matching: costs smoothed along 4 or 8 paths through every pixel.

Two sweeps run in parallel, one down and one up, on at most two threads. Each stores its paths' contributions for the
first half of its rows. In the second half it adds those that the other sweep stored, and selects the winners. One
volume of H W D numbers is stored, with 8 bits each where they suffice and 16 elsewhere.
"""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.matching.box import (
    FITS,
    BoxMatch,
    Rows,
    Volume,
    Winners,
    blank,
    box_sums,
    fence,
    in_strips,
    limits,
)

PATH_TOP = 8191  # largest cost of a path: the sum of eight fits 16 bits
STRIP_BYTES = 1 << 20  # size of a strip of costs, which stays in a processor's cache


@dataclass(frozen=True)
class Penalties:
    """P1 for a step of one disparity, P2 for a larger one, of costs from 0 to `top`."""

    small: int
    large: int
    top: int

    @classmethod
    def scaled(
        cls, parts: tuple[float, float], full: float, whole: bool
    ) -> tuple[float, "Penalties"]:
        """(gain, penalties) for costs that reach `full`, P1 and P2 as parts of it; whole costs that fit have gain 1."""
        # A path's cost is at most C + P2: the costs are scaled such that this stays below PATH_TOP.
        top = int(PATH_TOP / (1.0 + parts[1])) - 1
        if whole and full <= top:
            gain, top = 1.0, int(full)
        else:
            gain = top / full
        return gain, cls(round(parts[0] * top), round(parts[1] * top), top)

    @property
    def dtype(self) -> type[np.unsignedinteger[Any]]:
        """The dtype that holds a path's cost plus P1, and the detours of four paths, at most P2 each."""
        path_fits = self.top + self.large + self.small < 256
        detours_fit = 4 * self.large < 256
        return np.uint8 if path_fits and detours_fit else np.uint16


def quantised(
    boxes: tuple[BoxMatch, ...],
    gain: float,
    offset: float,
    penalties: Penalties,
    threads: int,
) -> Rows:
    """The sum of the boxes' costs, as round(cost * gain + offset); the largest cost where there is no partner.

    Costs of single pixels are computed in each sweep, which takes less time than reading them from memory; those of
    windows are stored.
    """
    box = boxes[0]
    costs = box_sums(boxes, gain, offset + 0.5, penalties.dtype)  # truncation rounds
    outside = np.zeros((1, box.shape[1], box.depth), penalties.dtype)
    blank(outside, box.low, box.count, penalties.top)

    def rows(y0: int, y1: int) -> Volume:
        part = costs(y0, y1)
        return np.maximum(part, outside, out=part)

    if box.side == 1:
        return rows
    return stored((*box.shape, box.depth), penalties, rows, box.rows, threads)


def stored(
    shape: tuple[int, int, int],
    penalties: Penalties,
    rows: Rows,
    strip: int,
    threads: int,
) -> Rows:
    """The same rows, all computed once, in strips, and stored in memory."""
    volume = np.empty(shape, penalties.dtype)

    def work(start: int, stop: int) -> None:
        volume[start:stop] = rows(start, stop)

    in_strips(work, shape[0], strip, threads)
    return lambda y0, y1: volume[y0:y1]


@dataclass(frozen=True)
class Sweeps:
    """Both sweeps over costs of shape (H, W, depth).

    paths: 4 (along rows and columns) or 8 (and diagonals). The winner is one of the disparities low..low+count-1.
    """

    costs: Rows
    shape: tuple[int, int, int]
    paths: int
    penalties: Penalties
    low: int
    count: int
    fit: str

    def winners(
        self,
        threads: int,
        *,
        rivals: bool,
        on_row: Callable[[int, NDArray[np.uint16]], None] | None = None,
    ) -> Winners:
        """The winners. on_row: called with each row's number and its sums of path costs (W, depth), before reuse."""
        height, width, _ = self.shape
        winners = Winners.empty((height, width), rivals)
        kept = np.empty(self.shape, self.penalties.dtype)
        down = self._run(False, kept, winners, on_row)
        up = self._run(True, kept, winners, on_row)
        upper, lower = (0, height // 2), (height // 2, height)
        with ThreadPoolExecutor(min(threads, 2)) as pool:
            # In the first half of its rows a sweep stores what the other one adds in its second half.
            _wait(pool.submit(down, *upper, False), pool.submit(up, *lower, False))
            _wait(pool.submit(down, *lower, True), pool.submit(up, *upper, True))
        return winners

    def _run(
        self,
        turned: bool,
        kept: Volume,
        winners: Winners,
        on_row: Callable[[int, NDArray[np.uint16]], None] | None,
    ) -> Callable[[int, int, bool], None]:
        """run(y0, y1, finish): carry one sweep through these rows, in strips."""
        from twinlens.matching.kernels.semiglobal import GUARD, slot_count, sweep_kernel

        height, width, depth = self.shape
        dtype = self.penalties.dtype
        # A path begins with costs of 0. Between the slots lie numbers that stay too large when P1 is added.
        slots = np.zeros((slot_count(height, width), depth + GUARD), dtype)
        slots[:, :GUARD] = np.iinfo(dtype).max - self.penalties.small
        flat = np.append(slots.ravel(), slots[0, :GUARD])
        minima, sums = np.zeros(len(slots), dtype), np.zeros(width * depth, np.uint16)
        penalties = dtype(self.penalties.small), dtype(self.penalties.large)
        kernel = sweep_kernel(self.paths == 8)
        paths = flat, minima
        search = sums, self.low, self.count, fence(np.uint16, self.count)
        ends = limits(np.uint16)
        row_bytes = width * depth * np.dtype(dtype).itemsize
        rows = 1 if on_row else max(1, STRIP_BYTES // row_bytes)

        def run(first: int, last: int, finish: bool) -> None:
            tops = range(first, last, rows)
            for y0 in reversed(tops) if turned else tops:
                y1 = min(y0 + rows, last)
                # The kernel counts rows in the order of the sweep.
                span = height - y1 if turned else y0, y1 - y0, *self.shape
                volumes = self.costs(y0, y1).reshape(-1), kept[y0:y1].reshape(-1)
                result = FITS[self.fit], ends, *winners.rows(y0, y1)
                kernel(volumes, paths, span, penalties, turned, finish, search, result)
                if on_row and finish:
                    on_row(y0, sums.reshape(width, depth))

        return run


def _wait(*futures: Future[None]) -> None:
    for future in futures:
        future.result()
