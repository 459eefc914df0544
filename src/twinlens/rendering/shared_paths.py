"""Traces the light paths of an annulus once and gathers them for every focus: the kernels of the lens grid.

Sample m of every pixel starts at the same position x in the pixel, passes through the same aperture point a, and lands
at x + s a for the shear s of each focus: the same integer number of pixels away for every starting pixel. So every
pixel of every image gathers sample m of exactly one pixel, in an order that does not depend on the number of threads.

Samples are multijittered (Kensler, Correlated Multi-Jittered Sampling, Pixar Technical Memo 13-01, 2013). Those of a
pixel land in several pixels. With a random order of strata in each pixel, some strata would be missing where samples
land; with one order for all pixels, all would have the same error, visible as blotches. So the first point on a light
and the first direction are stratified where samples land: only samples of equal shifts exchange strata. Later numbers
are stratified in the pixel where samples start. Either half of the samples has the strata of one colour of a
checkerboard, so that it is stratified by itself.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Camera
from twinlens.camera.aperture import NUMPY, on_ring
from twinlens.geometry import Float
from twinlens.rendering.annuli import ApertureAnnulus
from twinlens.rendering.backends import mitsuba
from twinlens.rendering.build import BuiltScene
from twinlens.rendering.ray_generation import RayGenerator, opaque
from twinlens.rendering.samplers import load_sampler, sampler_supports

mi = mitsuba()
import drjit as dr  # noqa: E402, Dr.Jit reads DRJIT_LIBLLVM_PATH when it is imported

Cells = NDArray[np.int64]
Grid = tuple[int, int]
Shifts = NDArray[np.int32]
Shares = Callable[[NDArray[np.float32]], Float]

MAX_SAMPLES = 1 << 12  # per pixel and pass
RAYS_PER_PASS = 3 << 23  # 300 MB of radiance; enough for 64 samples of 640x480 pixels
_TABLE_SIZE, _MIN_ROWS = 1 << 16, 32
_DIMENSIONS = 16  # stratified: four bounces; later dimensions are independent
_LIGHT, _BOUNCE = 0, 2  # of the first surface; dimension 1 chooses a lobe
_DIMENSION_KEY = 0x9E3779B9  # odd, so that the keys of dimensions differ
_ROUNDS = 6  # of the TEA hash; four rounds leave visible patterns


@dataclass(frozen=True, eq=False)
class SharedPaths:
    """The light paths of one camera through an annulus, and the images of all its vergences."""

    built: BuiltScene
    camera: Camera
    pose: Float
    annulus: ApertureAnnulus
    sampler: str

    def images(
        self,
        seeds: np.random.SeedSequence,
        focuses: Sequence[int],
        shares: Shares | None = None,
    ) -> tuple[Float, Float, int]:
        """Mean images (K, H, W, 3), their mean variances (K,), and the number of paths.

        Image k has the vergence ``annulus.vergences[focuses[k]]``. `shares` gives the weights (n, K) of samples in the
        images, from their points (n, 2) of the aperture in metres.

        Sums a and b over halves of n samples give the variance (a - b)^2 / n^2. The errors of the halves partly cancel,
        so it is an upper bound: exact for noise, and about twice the variance where stratification works best.
        """
        film = math.prod(self.annulus.film_size(self.camera))
        passes = math.ceil(
            self.annulus.spp / min(MAX_SAMPLES, max(1, RAYS_PER_PASS // film))
        )
        grid = stratum_grid(math.ceil(self.annulus.spp / passes))
        count = passes * math.prod(grid)
        total, squares = np.zeros(
            (2, len(focuses), 3, self.camera.height, self.camera.width)
        )
        for _ in range(passes):
            pattern_seed, path_seed = map(int, seeds.spawn(1)[0].generate_state(2))
            points, shifts = self._film_and_aperture(
                grid, np.random.default_rng(pattern_seed)
            )
            weights = None if shares is None else shares(points[:, 2:])
            # The radiance is not bound to a name, so that its memory is freed before the next pass.
            first, second = self._gather(
                self._radiance(grid, points, shifts, path_seed),
                shifts[:, np.asarray(focuses)],
                weights,
            )
            total += first + second
            squares += (first - second) ** 2 if count > 1 else math.nan
        variance = [
            of[np.isfinite(of)].mean() if np.isfinite(of).any() else math.nan
            for of in squares
        ]
        return (
            np.moveaxis(total, 1, -1) / count,
            np.array(variance) / count**2,
            count * film,
        )

    def _film_and_aperture(
        self, grid: Grid, random: np.random.Generator
    ) -> tuple[NDArray[np.float32], Shifts]:
        """Positions in the pixel and aperture points (n, 4), and shifts (n, F, 2) in pixels, of n shared samples."""
        places = np.hstack(
            [multijitter(random_cells(grid, random), grid, random) for _ in range(2)]
        )
        x, y, across, down = ((places + random.random(places.shape)) / len(places)).T
        aperture = on_ring(
            across, down, self.annulus.inner**2, self.annulus.outer**2, NUMPY
        )
        points = np.stack([x, y, *aperture], axis=-1).astype(np.float32)
        shears = np.subtract(self.annulus.vergences, self.annulus.middle)[:, None] * (
            self.camera.fx,
            self.camera.fy,
        )
        return points, np.floor(
            points[:, None, :2] + points[:, None, 2:] * shears
        ).astype(np.int32)

    def _radiance(
        self, grid: Grid, points: NDArray[np.float32], shifts: Shifts, seed: int
    ) -> Any:
        """Radiance of every ray. Sample m of n of a pixel is ray ``m + n * pixel``."""
        (width, height), n = self.annulus.film_size(self.camera), len(points)
        ray_index = dr.arange(mi.UInt32, width * height * n)
        samples, columns = dr.opaque(mi.UInt32, n), dr.opaque(mi.UInt32, width)
        pixel, sample = ray_index // samples, ray_index % samples
        x, y, ax, ay = (
            dr.gather(mi.Float, mi.Float(values.copy()), sample) for values in points.T
        )
        u = (
            mi.Float(pixel % columns)
            - opaque((width - self.camera.width) // 2 + 0.5)
            + x
        )
        v = (
            mi.Float(pixel // columns)
            - opaque((height - self.camera.height) // 2 + 0.5)
            + y
        )
        origin, direction = RayGenerator(self.camera, self.pose).ray(
            u, v, ax, ay, opaque(self.annulus.middle)
        )
        ray = mi.RayDifferential3f(mi.Ray3f(origin, direction))
        if self.sampler == "multijitter":
            sampler = StratifiedSampler(grid, shifts, pixel, sample, seed)
        else:
            kind = self.sampler if sampler_supports(self.sampler, n) else "independent"
            sampler = load_sampler(kind, n, width)
            sampler.set_samples_per_wavefront(n)
            sampler.seed(seed, width * height * n)
        radiance, valid, _ = self.built.integrator.sample(
            self.built.mi_scene, sampler, ray, None, True
        )
        radiance = dr.select(valid, radiance, 0.0)
        dr.eval(radiance)
        return radiance

    def _gather(
        self, radiance: Any, shifts: Shifts, weights: Float | None
    ) -> tuple[Float, Float]:
        """Sums (K, 3, H, W) of the radiance landing on each pixel, over the first and second half of the samples."""
        (n, images, _), (columns, rows) = (
            shifts.shape,
            self.annulus.film_size(self.camera),
        )
        shape = (images, self.camera.height, self.camera.width)
        image, down, across = np.indices(shape)
        pixel = (
            across
            + (columns - shape[2]) // 2
            + columns * (down + (rows - shape[1]) // 2)
        )
        step = np.arange(n)[:, None] - n * (shifts[..., 0] + columns * shifts[..., 1])
        start, own, steps = (
            mi.Int32(of.astype(np.int32).ravel()) for of in (n * pixel, image, step)
        )
        first, end, images = (
            dr.opaque(mi.Int32, count) for count in (n - n // 2, n, images)
        )
        factors = (
            None if weights is None else mi.Float(weights.astype(np.float32).ravel())
        )

        def add(m: Any, total: Any) -> tuple[Any, Any]:
            ray = mi.UInt32(start + dr.gather(mi.Int32, steps, m * images + own))
            seen = mi.Color3d(
                *(dr.gather(mi.Float, channel, ray) for channel in radiance)
            )
            if factors is not None:
                seen *= mi.Float64(dr.gather(mi.Float, factors, m * images + own))
            return m + 1, total + seen

        def add_samples(m: Any, last: Any) -> Float:
            _, total = dr.while_loop(
                (m, dr.zeros(mi.Color3d, image.size)), lambda m, _: m < last, add
            )
            return np.moveaxis(np.array(total).reshape(3, *shape), 0, 1)

        return add_samples(mi.Int32(0), first), add_samples(first, end)


def stratum_grid(wanted: int) -> Grid:
    """(columns, rows) of the smallest grid of at least `wanted` cells; the number of cells is even unless it is 1.

    >>> stratum_grid(32), stratum_grid(11), stratum_grid(1)
    ((8, 4), (4, 3), (1, 1))
    """
    side = math.isqrt(wanted)
    grids = (
        (2 * math.ceil(wanted / (2 * rows)), rows)
        for rows in range(side, side // 2, -1)
    )
    return min(grids, key=math.prod) if wanted > 1 else (1, 1)


def random_cells(grid: Grid, random: np.random.Generator) -> Cells:
    """All cells of the grid in random order: the squares of one colour before those of the other."""
    cells = random.permutation(math.prod(grid))
    colour = (cells % grid[0] + cells // grid[0] + random.integers(2)) % 2
    return cells[np.argsort(colour, kind="stable")]


def shuffle_within(classes: Cells, count: int, random: np.random.Generator) -> Cells:
    """Random permutations (count, n) of samples that exchange only samples of equal classes."""
    orders = np.empty((count, len(classes)), np.int64)
    orders[:, np.argsort(classes, kind="stable")] = np.argsort(
        classes + random.random(orders.shape), axis=1
    )
    return orders


def multijitter(cells: Cells, grid: Grid, random: np.random.Generator) -> Cells:
    """Random places (..., n, 2) on an n x n grid, within `cells` (..., n), that use every column and every row once."""
    parts = np.stack([cells % grid[0], cells // grid[0]])
    ranks = np.argsort(np.argsort(parts + random.random(parts.shape)))
    return np.moveaxis(ranks, 0, -1)


class StratifiedSampler(mi.Sampler):  # type: ignore[misc, name-defined]
    """Numbers for rays of the given `pixel` and `sample`. Each pixel has one row of a table of orders per dimension."""

    def __init__(
        self, grid: Grid, shifts: Shifts, pixel: Any, sample: Any, seed: int
    ) -> None:
        super().__init__(mi.Properties())
        random, n = np.random.default_rng(seed), len(shifts)
        groups = np.unique(shifts.reshape(n, -1), axis=0, return_inverse=True)[
            1
        ].ravel()
        self.set_sample_count(n)
        rows = max(_MIN_ROWS, _TABLE_SIZE // (_DIMENSIONS * n))
        half = np.arange(n) >= n - n // 2
        tables = []
        for dimension in range(_DIMENSIONS):
            classes = half + 2 * groups * (dimension in (_LIGHT, _BOUNCE))
            cells = random_cells(grid, random)[shuffle_within(classes, rows, random)]
            x, y = np.moveaxis(multijitter(cells, grid, random), -1, 0)
            tables.append(x | y << 16)
        self.table = mi.UInt32(np.ravel(tables).astype(np.uint32))
        self.table_size, self.count = (
            dr.opaque(mi.UInt32, rows * n),
            dr.opaque(mi.UInt32, n),
        )
        self.key, self.dimension = dr.opaque(mi.UInt32, seed), dr.opaque(mi.UInt32, 0)
        row = mi.sample_tea_32(pixel, self.key - _DIMENSION_KEY, _ROUNDS)[
            0
        ] % dr.opaque(mi.UInt32, rows)
        self.position = row * self.count + sample
        self.ray = dr.arange(mi.UInt32, dr.width(pixel))

    def next_1d(self, active: Any = True) -> Any:
        return self._next()[0]

    def next_2d(self, active: Any = True) -> Any:
        return mi.Point2f(*self._next())

    def _next(self) -> list[Any]:
        in_table = self.dimension < _DIMENSIONS
        places = dr.gather(
            mi.UInt32,
            self.table,
            self.position + self.dimension * self.table_size,
            in_table,
        )
        random = mi.sample_tea_32(
            self.ray, self.key + self.dimension * _DIMENSION_KEY, _ROUNDS
        )
        units = [mi.Float(bits >> 8) * 2.0**-24 for bits in random]
        self.dimension += 1
        return [
            dr.select(
                in_table,
                dr.minimum((mi.Float(place) + unit) / self.count, 1 - 2.0**-24),
                unit,
            )
            for place, unit in zip((places & 0xFFFF, places >> 16), units, strict=True)
        ]
