"""The samples that all pixels of a pass of the lens grid share: where they start, and where they land at each focus.

Sample m of every pixel starts at its place x in the pixel, goes through its aperture point a, and lands at x + s a for
the shear s of each focus. It moves by the same whole number of pixels from wherever it starts, so every pixel of every
image collects sample m of exactly one pixel: none is empty, and what is even over the samples of one is even over those
that land in another. The aperture points are stratified. The places are woven: each goes, several times in turn, where
it and the others land most evenly in the pixels of all focuses at once, edges taken as wrapped around. All are then
moved together by one uniform step around the pixel, which makes each of them uniform whatever the weaving did.

After Zaremba, The mathematical basis of Monte Carlo and quasi-Monte Carlo methods, SIAM Review 10, 1968 (the wrapped
kernel is that of Korobov spaces), and Cranley and Patterson, Randomization of number theoretic methods, 1976.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twinlens.camera.warp import NUMPY, on_ring
from twinlens.geometry import Float
from twinlens.rendering.strata import chessboard, multijitter

_MOST_WOVEN = 128  # weaving takes n^2 time: at 128 samples and four focuses a tenth of a second
_SWEEPS = 4
_SIDE = 32  # places tried along either axis of the pixel
_EXACT = 2.0**16  # kernels are whole multiples of 1/this: sums are exact, and alike in whatever order they are taken
_OWN_HALF = 0.25  # how much more evenness counts within a half of the samples
_BELOW_ONE = np.float32(1 - 2.0**-24)


@dataclass(frozen=True, eq=False)
class Pattern:
    """n samples, one in each stratum of the aperture.

    film : float32 (n, 2), places in the pixel, [0, 1); aperture : float32 (n, 2), metres.
    square : float32 (n, 2), places in the unit square that the ring of the aperture is warped from.
    shifts : int32 (n, F, 2), whole pixels from where a sample starts to where it lands, for each focus.
    group : int64 (n,), equal where the shifts are.
    white : bool (n,), half of the samples, those on the white squares of the aperture's strata; each half is spread
        evenly by itself.
    grid : (columns, rows) of the strata.
    """

    film: NDArray[np.float32]
    aperture: NDArray[np.float32]
    square: NDArray[np.float32]
    shifts: NDArray[np.int32]
    group: NDArray[np.int64]
    white: NDArray[np.bool_]
    grid: tuple[int, int]

    def __len__(self) -> int:
        return len(self.film)


def pattern(
    grid: tuple[int, int], inner: float, outer: float, shears: Sequence[tuple[float, float]], seed: int
) -> Pattern:
    """A random pattern.

    `inner`, `outer` : the ring's radii, metres; `shears` : pixels a metre of the aperture, (x, y), for each focus.
    """
    random = np.random.default_rng(seed)
    n = grid[0] * grid[1]
    white = chessboard(grid)
    square = multijitter(np.arange(n), grid, random)
    aperture = np.stack(on_ring(square[:, 0], square[:, 1], inner**2, outer**2, NUMPY), axis=-1).astype(np.float32)
    moves = aperture[:, None].astype(np.float64) * np.asarray(shears)
    woven = weave(moves, white, random) if n <= _MOST_WOVEN else multijitter(random.permutation(n), grid, random)
    film = np.minimum(((woven + random.random(2)) % 1.0).astype(np.float32), _BELOW_ONE)
    shifts = np.floor(film[:, None].astype(np.float64) + moves).astype(np.int32)
    group = np.unique(shifts.reshape(n, -1), axis=0, return_inverse=True)[1].ravel()
    return Pattern(film, aperture, square, shifts, group, white, grid)


def weave(moves: Float, white: NDArray[np.bool_], random: np.random.Generator) -> Float:
    """Places (n, 2) around the pixel whose landings ``place + moves[:, f]`` are even for every f.

    Sample by sample, in random orders, each takes that place of a randomly laid grid where the sum over the others'
    landings of `kernel` is least.

    `moves` : (n, F, 2), pixels; `white` : bool (n,), halves that are to be even by themselves too.
    """
    n, focuses, _ = moves.shape
    places, placed = np.zeros((n, 2)), np.zeros(n, bool)
    weights = 1.0 + _OWN_HALF * (white[:, None] == white)
    for m in (m for _ in range(_SWEEPS) for m in random.permutation(n)):
        placed[m] = False
        lines = (np.arange(_SIDE)[:, None] + random.random(2)) / _SIDE
        seen = (places[placed, None] + moves[placed] - moves[m]).reshape(-1, 2)
        across, down = (kernel(lines[:, axis, None] - seen[:, axis]) for axis in (0, 1))
        crowd = (across * np.repeat(weights[m, placed], focuses)) @ down.T
        best = np.unravel_index(np.argmin(crowd), crowd.shape)
        places[m] = lines[best[0], 0], lines[best[1], 1]
        placed[m] = True
    return places


def kernel(apart: Float) -> Float:
    """How much two samples crowd each other along one axis, wrapped: the sum over all k of cos(2 pi k t) / max(1, k^2).

    That is 1 + 2 pi^2 (t^2 - t + 1/6) of the fractional part t, rounded. The mean over all pairs of the product of both
    axes is the mean square error of pixels whose waves of k and l periods have the amplitudes 1 / (k l).

    >>> kernel(np.array([0.0, 0.5, 1.0])).round(2).tolist()
    [4.29, -0.64, 4.29]
    """
    t = apart - np.floor(apart)
    rounded: Float = np.rint((1 + 2 * math.pi**2 * (t * t - t + 1 / 6)) * _EXACT) / _EXACT
    return rounded
