"""Semi-global matching: the whole cost volume, smoothed along 4 or 8 paths through every pixel.

Memory is three volumes of H W D 16-bit numbers. The two sweeps, down and up, run side by side, so that no more than
two threads help here.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.matching.box import FITS, BoxMatch, in_strips
from twinlens.matching.volume import Chosen, fill_sum

PATH_TOP = 8191  # the most that a path's cost may be: eight of them add up in 16 bits
LANES = 16
Volume = NDArray[np.uint16]


def scaled(full: float, whole: bool, large: float) -> tuple[float, int]:
    """(gain, largest cost) for 16-bit costs, where the volume's costs reach `full` and P2 is `large` times that.

    Whole numbers that fit are kept as they are.
    """
    top = int(PATH_TOP / (1.0 + large)) - 1
    return (1.0, int(full)) if whole and full <= top else (top / full, top)


def quantised(boxes: Sequence[BoxMatch], gain: float, offset: float, top: int, threads: int) -> Volume:
    """The sum of the boxes' costs, as round(cost * gain + offset), (H, W, depth); `top` where there is no partner."""
    height, width = boxes[0].shape
    depth = -(-boxes[0].depth // LANES) * LANES
    volume = np.empty((height, width, depth), np.uint16)

    def work(y0: int, y1: int) -> None:
        fill_sum(boxes, volume[y0:y1], y0, gain, offset + 0.5, float(top))

    in_strips(work, height, boxes[0].rows, threads)
    return volume


def swept(costs: Volume, paths: int, small: int, large: int, threads: int = 2) -> list[Volume]:
    """The two half sums of path costs, (H, W, depth) each: from above and the left, and from below and the right.

    costs (H, W, depth), depth a multiple of 16, up to 8191 - large; paths 4 (along rows and columns) or 8 (and
    diagonals); small and large are the penalties P1 and P2 in the same numbers.
    """
    from twinlens.matching.kernels.semiglobal import GUARD, TOO_HIGH, slot_count, sweep_kernel

    height, width, depth = costs.shape
    lanes = next(n for n in (128, 64, 32, 16) if depth % n == 0)

    def sweep(turned: bool) -> Volume:
        total = np.empty_like(costs)
        slots = np.zeros((slot_count(height, width), depth + GUARD), np.uint16)
        slots[:, :GUARD] = TOO_HIGH
        flat = np.append(slots.ravel(), np.full(GUARD, TOO_HIGH, np.uint16))
        minima = np.zeros(len(slots), np.uint16)
        penalties = np.uint16(small), np.uint16(large)
        kernel = sweep_kernel(lanes, paths == 8, turned)
        kernel(costs.reshape(-1), total.reshape(-1), flat, minima, height, width, depth, penalties)
        return total

    with ThreadPoolExecutor(min(threads, 2)) as pool:
        return list(pool.map(sweep, (False, True)))


def settled(halves: Sequence[Volume], low: int, count: int, fit: str, threads: int, *, rivals: bool) -> Chosen:
    """The winner of the two halves' sum at each pixel, as `volume.Chosen`."""
    from twinlens.matching.kernels.semiglobal import settle_kernel

    height, width, depth = halves[0].shape
    lanes = next(n for n in (128, 64, 32, 16) if depth % n == 0)
    chosen = Chosen.empty((height, width))
    no_one = np.empty((1, 1))

    def work(y0: int, y1: int) -> None:
        one, other = (half[y0:y1].reshape(-1) for half in halves)
        maps: tuple[Any, ...] = (
            chosen.cost[y0:y1],
            chosen.rival[y0:y1] if rivals else no_one,
            chosen.disparity[y0:y1],
        )
        settle_kernel(lanes)(one, other, depth, low, count, FITS[fit], np.empty(depth, np.uint16), *maps)

    in_strips(work, height, -(-height // threads), threads)
    return chosen
