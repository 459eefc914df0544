"""Strata for what follows along the paths of the lens grid, once their samples have landed elsewhere.

The samples of a pixel land in several, and those of several in one (`twinlens.rendering.pattern`). Random orders of
strata in each pixel would leave a pixel with some strata twice and others never, one order for all pixels would leave
them all with the same error, seen as blotches. So, of the pairs and numbers that a path takes:

- the first two pairs, a place on a light and a direction to go on, are stratified where samples land: all pixels share
  one order, but samples of equal shifts, which travel together, trade their strata pixel by pixel;
- all others are stratified in the pixel where they start, in an order of its own.

A choice by numbers (cards at 240x180, 64 samples, 24 lenses; mean variance of pixels and of 8x8 means over those of
direct images): as here 0.91 and 0.88, with the light alone 0.97 and 0.86; the narrowest aperture, when all pixels share
one order, 0.8 and 4.7.

Orders are dealt from a deck on the host: one gather a draw, no divisions. Rays are numbered by the stratum of their
first bounce, so that those traced at once go much the same way.

After Kensler, Correlated Multi-Jittered Sampling, Pixar Technical Memo 13-01, 2013.
"""

import functools
import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from twinlens.rendering.backends import mitsuba

if TYPE_CHECKING:
    from twinlens.rendering.pattern import Pattern

MOST = 1 << 12  # samples of a pattern
_DIMENSION = 0x9E3779B9  # odd: keys of dimensions do not meet
_PICK = 0x55555555  # tells the choice of an order from the jitter
_DECK = 1 << 14  # strata in a deck of orders, 64 kB, unless there are very many samples
_ROUNDS = 6  # of the cipher that makes numbers of numbers: after four, small ones still show
_FEWEST = 64  # orders in a deck: paths of 15 bounces are stratified all along
_LIGHT, _BOUNCE = 2, 4  # dimensions: film 0, aperture 1, the first light, a number that chooses a lobe, the bounce
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


def chessboard(grid: tuple[int, int]) -> NDArray[np.bool_]:
    """Whether cells 0, 1, ... of columns * rows are white."""
    cell = np.arange(grid[0] * grid[1])
    white: NDArray[np.bool_] = (cell % grid[0] + cell // grid[0]) % 2 == 1
    return white


def multijitter(cell: NDArray[np.int64], grid: tuple[int, int], random: np.random.Generator) -> NDArray[np.float32]:
    """Points of the unit square, (n, 2): one in each cell, and one in each n-th of either axis."""
    places = (_fine(cell[None], grid, random)[0] + random.random((len(cell), 2))) / len(cell)
    points: NDArray[np.float32] = np.minimum(places.astype(np.float32), _BELOW_ONE)
    return points


def _fine(cells: NDArray[np.int64], grid: tuple[int, int], random: np.random.Generator) -> NDArray[np.int64]:
    """Columns and rows (count, n, 2) on a grid of n x n, each taken once by the n samples of an order of `cells`."""
    columns, rows = grid
    column, row = cells % columns, cells // columns
    across, down = (np.argsort(random.random((len(cells), size)), axis=1) for size in (rows, columns))
    x = column * rows + np.take_along_axis(across, row, axis=1)
    y = row * columns + np.take_along_axis(down, column, axis=1)
    return np.stack([x, y], axis=-1)


def deal(
    tosses: NDArray[np.bool_],
    classes: NDArray[np.int64],
    white: NDArray[np.bool_],
    grid: tuple[int, int],
    random: np.random.Generator,
) -> NDArray[np.int64]:
    """Orders (len(tosses), n) of strata: in each, samples of a class have the same strata, which they trade.

    White samples have the strata of white squares where the order's toss, an even one, says so, or else of black ones:
    each half of the samples is even by itself, and any stratum as likely as any other. `classes` must tell them apart.
    """
    board = chessboard(grid)
    strata_of = np.empty((2, len(white)), np.int64)
    for toss, squares in enumerate((~board, board) if white.any() else (board, board)):
        for half in (False, True):
            strata_of[toss, white == half] = random.permutation(np.flatnonzero(squares == half))
    shuffled = np.empty((len(tosses), len(white)), np.int64)
    shuffled[:, np.argsort(classes, kind="stable")] = np.argsort(classes + random.random(shuffled.shape), axis=1)
    dealt: NDArray[np.int64] = strata_of[tosses.astype(int)[:, None], shuffled]
    return dealt


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
            self.grid = columns, rows
            self.set_sample_count(columns * rows)
            self.orders = max(_FEWEST, 1 << (_DECK // (columns * rows)).bit_length() - 1)

        def start(self, shared: "Pattern", pixels: int, seed: int) -> None:
            """Begin a pass over `pixels` pixels. Ray ``pixel + pixels * slot`` is of the sample that the pixel's own
            order puts into that slot, the stratum of its first bounce."""
            random, n, count = np.random.default_rng(seed), len(shared), self.orders
            self._number(pixels, seed)
            together = 2 * shared.group + shared.white
            light, bounce = (
                deal(np.full(count, random.random() < 0.5), together, shared.white, self.grid, random) for _ in range(2)
            )
            later = deal(random.random(count) < 0.5, shared.white.astype(int), shared.white, self.grid, random)
            cells = light, np.tile(np.arange(n), (count, 1)), later
            self.deck = mi.UInt32(np.concatenate([_packed(of, self.grid, random) for of in cells]).ravel())
            samples = mi.UInt32(np.argsort(bounce, axis=1).astype(np.uint32).ravel())
            self.sample = dr.gather(mi.UInt32, samples, self.cut % count * n + self.slot)

        def start_by_pixel(self, pixels: int, seed: int) -> None:
            """The same for film and aperture alone: ray ``slot + n * pixel`` is of sample `slot`, as Mitsuba counts."""
            self._number(pixels, seed)
            n = dr.opaque(mi.UInt32, self.sample_count())
            self.pixel, self.sample = self.ray // n, self.ray % n

        def _number(self, pixels: int, seed: int) -> None:
            self.ray = dr.arange(mi.UInt32, pixels * self.sample_count())
            inner = dr.opaque(mi.UInt32, pixels)
            self.slot, self.pixel = self.ray // inner, self.ray % inner
            self.key = dr.opaque(mi.UInt32, seed)
            self.dimension = dr.opaque(mi.UInt32, 0)
            self.cut, step = mi.sample_tea_32(self.pixel, self.key ^ _PICK, _ROUNDS)
            self.step = step | 1

        def next_1d(self, active: Any = True) -> Any:
            return self._pair()[0]

        def next_2d(self, active: Any = True) -> Any:
            return mi.Point2f(*self._pair())

        def next_own(self) -> tuple[Any, Any]:
            """Two independent numbers of each ray."""
            return tuple(_unit(bits) for bits in mi.sample_tea_32(self.ray, self._next_key(), _ROUNDS))

        def _next_key(self) -> Any:
            key = self.key + self.dimension * _DIMENSION
            self.dimension += 1
            return key

        def _pair(self) -> tuple[Any, Any]:
            """The next dimension's two numbers: one in each stratum, and one in each n-th of either axis.

            A pixel cuts the deck and takes every so manieth order: a new one for each dimension until all are used,
            whatever is drawn after that is not stratified.
            """
            dimension, key = mi.UInt32(self.dimension), self._next_key()
            light, bounce = dimension == _LIGHT, dimension == _BOUNCE
            order = (self.cut + dimension * self.step) % self.orders
            order += dr.select(light, 0, dr.select(bounce, self.orders, 2 * self.orders))
            place = order * self.sample_count() + dr.select(bounce, self.slot, self.sample)
            both = dr.gather(mi.UInt32, self.deck, place)
            units = [_unit(bits) for bits in mi.sample_tea_32(self.ray, key, _ROUNDS)]
            dealt = [
                dr.minimum((mi.Float(part) + unit) / self.sample_count(), _BELOW_ONE)
                for part, unit in zip((both & 0xFFFF, both >> 16), units, strict=True)
            ]
            fresh = dimension < self.orders
            return dr.select(fresh, dealt[0], units[0]), dr.select(fresh, dealt[1], units[1])

        def to_string(self) -> str:
            return f"StrataSampler[{self.grid[0]} x {self.grid[1]}]"

    def _unit(bits: Any) -> Any:
        return mi.Float(bits >> 8) * 2.0**-24

    return StrataSampler


def _packed(cells: NDArray[np.int64], grid: tuple[int, int], random: np.random.Generator) -> NDArray[np.uint32]:
    """`_fine` columns and rows in the low and high 16 bits."""
    x, y = np.moveaxis(_fine(cells, grid, random), -1, 0)
    packed: NDArray[np.uint32] = (x | y << 16).astype(np.uint32)
    return packed
