"""The cost of descriptors, such as those of a learned network: 1 - their product, summed over windows."""

import numpy as np
from numpy.typing import NDArray

from twinlens.matching.box import Rows, Volume

TILE = 32  # columns of one matrix product: so few that BLAS takes no threads, since the strips have them


def descriptor_costs(
    left: NDArray[np.float32],
    right: NDArray[np.float32],
    side: int,
    low: int,
    depth: int,
) -> Rows:
    """rows(start, stop): the costs (stop - start, W, depth), float64, of descriptors (H, W, C).

    The cost of a pixel is 1 - l . r, from 0 to 2 for descriptors of unit length; that of a window, the sum over its
    side^2 pixels. Candidate j has disparity low + j. Outside the image its edge pixels are repeated.
    """
    height, width, _ = left.shape
    radius = side // 2
    ours = np.clip(np.arange(-radius, width + radius), 0, width - 1)
    theirs = np.clip(
        np.arange(-radius - low - depth + 1, width + radius - low), 0, width - 1
    )

    def rows(start: int, stop: int) -> Volume:
        volume = np.zeros((stop - start, width, depth))
        for y in range(start - radius, stop + radius):
            here = min(max(y, 0), height - 1)
            line = _window_sums(
                _products(left[here, ours], right[here, theirs], depth), side
            )
            volume[max(y - radius - start, 0) : max(y + radius + 1 - start, 0)] += (
                side - line
            )
        return volume

    return rows


def _products(
    left: NDArray[np.float32], right: NDArray[np.float32], depth: int
) -> NDArray[np.float32]:
    """(W, depth): the products of the left descriptors (W, C) with those at right[u + depth - 1 - j], j < depth."""
    products = np.empty((len(left), depth), np.float32)
    for first in range(0, len(left), TILE):
        some = left[first : first + TILE]
        table = some @ right[first : first + len(some) + depth - 1].T
        step = table.strides[1]
        diagonals = np.lib.stride_tricks.as_strided(
            table[:, depth - 1 :],
            (len(some), depth),
            (table.strides[0] + step, -step),
            writeable=False,
        )
        products[first : first + len(some)] = diagonals
    return products


def _window_sums(line: NDArray[np.float32], side: int) -> NDArray[np.float64]:
    """The sums over `side` columns in a row, (W - side + 1, depth)."""
    total = line[: len(line) - side + 1].astype(np.float64)
    for shift in range(1, side):
        total += line[shift : len(total) + shift]
    return total
