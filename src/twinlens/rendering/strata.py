"""Samples for film positions that are sheared afterwards: stratified in every pixel they land in, at every focus.

The samples of a ray (pixel, place in the pixel x, aperture point a) land at x + s a for the shear s of each focus.
Random orders would leave a pixel with some strata twice and others never, once samples from several pixels meet in it.
So sample m of all pixels of a pass moves by the same whole number of pixels at each focus: every pixel of every image
collects sample m of exactly one pixel, hence all strata once, and no pixel is ever empty. What a target cannot notice
is free, and drawn pixel by pixel so that neighbours err independently:

- x and a move within their strata wherever that leaves the whole shifts as they are (a Metropolis step, whose uniform
  distribution over the places of one set of shifts is exact);
- samples of equal shifts travel together, so they trade the strata of the first light among themselves;
- what follows along the path is stratified in the pixel where it starts, and no longer where it lands.

The last is a choice by numbers (part of the still life at 640x480, 64 samples, six apertures, shears to 2 pixels;
variance of pixels and of 8x8 means over those of direct images, four of the 24 cells): orders shared in every dimension
1.1 and 6, in film, aperture, first light and first bounce 1.0 and 2.4, without the bounce, as here, 1.2 and 1.4. With
independent orders in film and aperture too the pixels' rises to some 1.6. Light that neighbours sample in one order is
blotched, and deep strata gain little.

After Kensler, Correlated Multi-Jittered Sampling, Pixar Technical Memo 13-01, 2013; Metropolis et al., 1953.
"""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera.warp import NUMPY, on_ring
from twinlens.geometry import Float
from twinlens.rendering.backends import mitsuba

_DIMENSION = 0x9E3779B9  # odd: keys of dimensions do not meet
_WITHIN = 0x55555555  # tells the order within strata from the jitter
_GROUP = 0x85EBCA6B  # tells groups apart
_ROUNDS = 6
_SHARED = 3  # dimensions whose strata hold where samples land: film, aperture, first light
_BELOW_ONE = np.float32(1 - 2.0**-24)


def strata(wanted: int) -> tuple[int, int]:
    """(columns, rows) of a grid of at least `wanted` cells, as few as can be, of even number unless that is 1.

    It is no more than four times as wide as high, and even so that black and white squares are as many.

    >>> strata(32), strata(11), strata(25), strata(1)
    ((8, 4), (4, 3), (7, 4), (1, 1))
    """
    if wanted == 1:
        return 1, 1
    grids = []
    for rows in range(math.isqrt(wanted), 0, -1):
        columns = math.ceil(wanted / rows)
        columns += columns * rows % 2
        if columns <= 4 * rows:
            grids.append((columns, rows))
    return min(grids, key=lambda grid: grid[0] * grid[1])


@dataclass(frozen=True, eq=False)
class Pattern:
    """The n samples that all pixels of a pass share, ordered so that samples of equal shifts follow each other.

    film : float32 (n, 2), places in the pixel, [0, 1); aperture : float32 (n, 2), metres.
    film_cell, aperture_cell : uint32 (n,), their strata, column + columns * row.
    shifts : int32 (n, F, 2), whole pixels from where a sample starts to where it lands, for each focus.
    first, size : uint32 (n,), the first sample of equal shifts and how many there are.
    white : bool (n,), half of the samples: those on the white squares of both boards of strata, or on white ones of
        the film and black ones of the aperture. Each half is spread evenly by itself.
    grid : (columns, rows) of the strata.
    """

    film: NDArray[np.float32]
    aperture: NDArray[np.float32]
    film_cell: NDArray[np.uint32]
    aperture_cell: NDArray[np.uint32]
    shifts: NDArray[np.int32]
    first: NDArray[np.uint32]
    size: NDArray[np.uint32]
    white: NDArray[np.bool_]
    grid: tuple[int, int]

    def __len__(self) -> int:
        return len(self.film)


def pattern(
    grid: tuple[int, int], inner: float, outer: float, shears: Sequence[tuple[float, float]], seed: int
) -> Pattern:
    """A random pattern of one sample a stratum.

    `inner`, `outer` : the ring's radii, metres; `shears` : pixels a metre of the aperture, (x, y), for each focus.
    """
    random = np.random.default_rng(seed)
    n = grid[0] * grid[1]
    cells = _paired_cells(grid, random)
    film, square = (multijitter(cell, grid, random) for cell in cells)
    aperture = np.stack(on_ring(square[:, 0], square[:, 1], inner**2, outer**2, NUMPY), axis=-1).astype(np.float32)
    landing = film[:, None].astype(np.float64) + aperture[:, None] * np.asarray(shears)
    shifts = np.floor(landing).astype(np.int32)
    _, first, group, size = np.unique(
        shifts.reshape(n, -1), axis=0, return_index=True, return_inverse=True, return_counts=True
    )
    group = group.ravel()
    order = np.argsort(group, kind="stable")
    first = np.cumsum(size) - size
    white = _white(cells[0], grid)
    tables = (values[order] for values in (film, aperture, *cells, shifts, first[group], size[group], white))
    film, aperture, film_cell, aperture_cell, shifts, first, size, white = tables
    return Pattern(
        film, aperture, film_cell, aperture_cell, shifts, first.astype(np.uint32), size.astype(np.uint32), white, grid
    )


def _white(cell: NDArray[np.uint32], grid: tuple[int, int]) -> NDArray[np.bool_]:
    """Whether a stratum is a white square of the chessboard."""
    white: NDArray[np.bool_] = (cell % grid[0] + cell // grid[0]) % 2 == 1
    return white


def _paired_cells(grid: tuple[int, int], random: np.random.Generator) -> list[NDArray[np.uint32]]:
    """Strata of the film and of the aperture, (n,) each: any pair as likely as any other, white with white or black.

    Two equal halves and an even toss for which goes with which: each stratum of one meets each of the other equally.
    """
    cell = np.arange(grid[0] * grid[1], dtype=np.uint32)
    white = _white(cell, grid)
    film, aperture = ([random.permutation(cell[~white]), random.permutation(cell[white])] for _ in range(2))
    if len(cell) > 1 and random.random() < 0.5:
        aperture.reverse()
    return [np.concatenate(film), np.concatenate(aperture)]


def multijitter(cell: NDArray[np.uint32], grid: tuple[int, int], random: np.random.Generator) -> NDArray[np.float32]:
    """Points of the unit square, (n, 2): one in each cell, and one in each n-th of either axis."""
    columns, rows = grid
    column, row = cell % columns, cell // columns
    across, down = random.permutation(rows)[row], random.permutation(columns)[column]
    jitter: Float = random.random((len(cell), 2))
    x = (column + (across + jitter[:, 0]) / rows) / columns
    y = (row + (down + jitter[:, 1]) / columns) / rows
    return np.minimum(np.stack([x, y], axis=-1).astype(np.float32), _BELOW_ONE)


@functools.cache
def _coprimes(n: int) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
    """Row m of the first holds the numbers below m without a common factor, m = 0 to n; the second their count."""
    steps, choices = np.zeros((n + 1, n), np.uint32), np.ones(n + 1, np.uint32)
    for m in range(2, n + 1):
        found = [step for step in range(1, m) if math.gcd(step, m) == 1]
        steps[m, : len(found)], choices[m] = found, len(found)
    return steps, choices


def strata_sampler(grid: tuple[int, int]) -> Any:
    """A Mitsuba sampler of columns * rows samples a pixel: call its `start` with a pattern before use."""
    return _sampler_class()(*grid)


@functools.cache
def _sampler_class() -> Any:
    """Its base exists only once a variant is set."""
    import drjit as dr

    mi = mitsuba()

    class StrataSampler(mi.Sampler):  # type: ignore[misc, name-defined]
        """See the module."""

        def __init__(self, columns: int, rows: int) -> None:
            super().__init__(mi.Properties())
            self.columns, self.rows = columns, rows
            self.set_sample_count(columns * rows)

        def start(self, shared: Pattern, pixels: int, seed: int, by_sample: bool = True) -> None:
            """Begin a pass over `pixels` pixels. A ray is number ``pixel + pixels * sample``, or sample by sample of a
            pixel, as Mitsuba's samplers count."""
            self.ray = dr.arange(mi.UInt32, pixels * len(shared))
            inner = dr.opaque(mi.UInt32, pixels if by_sample else len(shared))
            places = self.ray // inner, self.ray % inner
            self.sample, self.pixel = places if by_sample else reversed(places)
            self.first = dr.gather(mi.UInt32, mi.UInt32(shared.first), self.sample)
            # At least 1: lanes beyond the last ray gather zeros, and dividing by one of those ends the process.
            self.size = dr.maximum(dr.gather(mi.UInt32, mi.UInt32(shared.size), self.sample), 1)
            steps, choices = _coprimes(len(shared))
            self.steps = mi.UInt32(steps.ravel())
            self.choices = dr.maximum(dr.gather(mi.UInt32, mi.UInt32(choices), self.size), 1)
            self.most = int(choices[-1])
            self.key = dr.opaque(mi.UInt32, seed)
            self.dimension = dr.opaque(mi.UInt32, 0)

        def next_1d(self, active: Any = True) -> Any:
            key, stratum = self._stratum()
            return (mi.Float(stratum) + _unit(mi.sample_tea_32(self.ray, key, _ROUNDS)[0])) / self.sample_count()

        def next_2d(self, active: Any = True) -> Any:
            key, stratum = self._stratum()
            return self._within(stratum, key)

        def next_in(self, cells: NDArray[np.uint32]) -> Any:
            """A pair in the given stratum of each sample, (n,)."""
            return self._within(dr.gather(mi.UInt32, mi.UInt32(cells), self.sample), self._next_key())

        def _next_key(self) -> Any:
            key = self.key + self.dimension * _DIMENSION
            self.dimension += 1
            return key

        def _stratum(self) -> tuple[Any, Any]:
            """One order of strata for all pixels, within which samples that travel together trade places."""
            together = self.dimension < _SHARED
            first = dr.select(together, self.first, 0)
            size = dr.select(together, self.size, self.sample_count())
            choices = dr.select(together, self.choices, self.most)
            key = self._next_key()
            turn, choice = mi.sample_tea_32(self.pixel, key ^ (first * _GROUP), _ROUNDS)
            step = dr.gather(mi.UInt32, self.steps, size * self.sample_count() + choice % choices)
            sample = first + ((self.sample - first) * step + turn % size) % size
            return key, mi.permute_kensler(sample, self.sample_count(), key)

        def _within(self, stratum: Any, key: Any) -> Any:
            """Rook-like within the strata too: sub-columns follow the rows, sub-rows the columns, both shuffled."""
            column, row = stratum % self.columns, stratum // self.columns
            shuffle = mi.sample_tea_32(self.pixel, key ^ _WITHIN, _ROUNDS)
            across = mi.permute_kensler(row, self.rows, shuffle[0])
            down = mi.permute_kensler(column, self.columns, shuffle[1])
            jitter = mi.sample_tea_32(self.ray, key, _ROUNDS)
            x = (mi.Float(column) + (mi.Float(across) + _unit(jitter[0])) / self.rows) / self.columns
            y = (mi.Float(row) + (mi.Float(down) + _unit(jitter[1])) / self.columns) / self.rows
            return mi.Point2f(x, y)

        def to_string(self) -> str:
            return f"StrataSampler[{self.columns} x {self.rows}]"

    def _unit(bits: Any) -> Any:
        return mi.Float(bits >> 8) * 2.0**-24

    return StrataSampler
