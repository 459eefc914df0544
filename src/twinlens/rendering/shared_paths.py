"""Traces the light paths of an annulus once and gathers them for every focus: the kernels of the lens grid.

Sample m of every pixel starts at the same position x in the pixel and passes through the same aperture point a. In the
image of each focus, with the shear s, it lands at x + s a: the same whole number of pixels away from every pixel where
it starts. So every pixel of every image gathers sample m from exactly one pixel, in an order that does not depend on
the number of threads.

Samples are multijittered (Kensler, Correlated Multi-Jittered Sampling, Pixar Technical Memo 13-01, 2013): the numbers
that a sample draws are places in a grid of strata, each used once. But the samples that start in one pixel land in
several. If each pixel gave its strata to its samples in a random order, those that land in a pixel would lack some
strata and repeat others. If all pixels had the same order, all would have the same error, visible as blotches. So
the samples that have equal shifts in all images, and thus land together, exchange their strata at random, and no others
do. This holds for the first point on a light and the first direction. Later numbers are stratified in the pixel where
samples start.

The first half of the samples has the strata of one colour of a checkerboard, and the second half has the others, so
that each half is stratified by itself.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Camera
from twinlens.camera.aperture import NUMPY, on_ring
from twinlens.camera.lens import paraxial_ray
from twinlens.geometry import Float
from twinlens.rendering.annuli import ApertureAnnulus, Shares
from twinlens.rendering.arrays import aligned
from twinlens.rendering.backends import mitsuba
from twinlens.rendering.build import BuiltScene
from twinlens.rendering.ray_generation import RayGenerator, opaque
from twinlens.rendering.samplers import load_sampler, sampler_supports

mi = mitsuba()
import drjit as dr  # noqa: E402, Dr.Jit reads DRJIT_LIBLLVM_PATH when it is imported

Cells = NDArray[np.int64]
Grid = tuple[int, int]
Shifts = NDArray[np.int32]

MAX_SAMPLES = 1 << 12  # per pixel and pass
PATHS_PER_PASS = 3 << 23  # 300 MB of radiance; enough for 64 samples of 640x480 pixels
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
        most_per_pass = min(MAX_SAMPLES, max(1, PATHS_PER_PASS // film))
        passes = math.ceil(self.annulus.spp / most_per_pass)
        grid = stratum_grid(math.ceil(self.annulus.spp / passes))
        count = passes * math.prod(grid)
        shape = len(focuses), 3, self.camera.height, self.camera.width
        total, squares = np.zeros(shape), np.zeros(shape)
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
        images = np.moveaxis(total, 1, -1) / count
        variances = np.array([_finite_mean(image) for image in squares]) / count**2
        return images, variances, count * film

    def _film_and_aperture(
        self, grid: Grid, random: np.random.Generator
    ) -> tuple[NDArray[np.float32], Shifts]:
        """Positions in the pixel and aperture points (n, 4), and shifts (n, F, 2) in pixels, of n shared samples.

        Positions are in [0, 1)^2, aperture points in metres. Rays are traced for the vergence k of the annulus' middle.
        In the image of vergence k', a ray through the aperture point a is that of a film point (k' - k) fx a away.
        """
        # Places on two n x n grids, jittered: (x, y) in the pixel, (across, down) in a unit square for the aperture.
        annulus = self.annulus
        film_places = multijitter(random_cells(grid, random), grid, random)
        aperture_places = multijitter(random_cells(grid, random), grid, random)
        places = np.hstack([film_places, aperture_places])
        x, y, across, down = ((places + random.random(places.shape)) / len(places)).T
        ax, ay = on_ring(across, down, annulus.inner**2, annulus.outer**2, NUMPY)
        points = np.stack([x, y, ax, ay], axis=-1).astype(np.float32)
        # x + s a in pixels, with the shear s = (k' - k) (fx, fy): its whole part is the shift of the sample.
        vergence_changes = np.subtract(annulus.vergences, annulus.middle)
        shears = vergence_changes[:, None] * (self.camera.fx, self.camera.fy)
        landing = points[:, None, :2] + points[:, None, 2:] * shears
        return points, np.floor(landing).astype(np.int32)

    def _radiance(
        self, grid: Grid, points: NDArray[np.float32], shifts: Shifts, seed: int
    ) -> Any:
        """Radiance of every ray. Sample m of n of a pixel is ray ``m + n * pixel``."""
        (width, height), n = self.annulus.film_size(self.camera), len(points)
        ray_index = dr.arange(mi.UInt32, width * height * n)
        samples = dr.opaque(mi.UInt32, n)
        columns = dr.opaque(mi.UInt32, width)
        pixel, sample = ray_index // samples, ray_index % samples
        columns_of_points = [mi.Float(values.copy()) for values in points.T]
        x, y, ax, ay = (
            dr.gather(mi.Float, values, sample) for values in columns_of_points
        )
        # The film has a margin on all sides. Pixel centres are at integers, x = 0 is the left edge of a pixel.
        margin_x = (width - self.camera.width) // 2
        margin_y = (height - self.camera.height) // 2
        u = mi.Float(pixel % columns) - opaque(margin_x + 0.5) + x
        v = mi.Float(pixel // columns) - opaque(margin_y + 0.5) + y
        rays = RayGenerator(self.camera, self.pose)
        vergence = opaque(self.annulus.middle)
        # From the pixel to the camera's frame, and to the world: o = (ax, ay, 0), d = (x - k ax, y - k ay, 1).
        in_camera = paraxial_ray(*rays.coordinates(u, v), ax, ay, vergence)
        ray = mi.RayDifferential3f(mi.Ray3f(*rays.in_world(*in_camera)))
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
        n, images, _ = shifts.shape
        columns, rows = self.annulus.film_size(self.camera)
        shape = (images, self.camera.height, self.camera.width)
        image, down, across = np.indices(shape)
        left, above = (columns - shape[2]) // 2, (rows - shape[1]) // 2
        pixel = across + left + columns * (down + above)
        # Sample m that lands on a pixel of the film started `shifts` before it, and is ray m + n * (pixel - shift).
        shift = shifts[..., 0] + columns * shifts[..., 1]
        step = np.arange(n)[:, None] - n * shift
        first_ray = _int32(n * pixel)
        image_number = _int32(image)
        steps = _int32(step)
        first_half = dr.opaque(mi.Int32, n - n // 2)
        all_samples = dr.opaque(mi.Int32, n)
        row_length = dr.opaque(mi.Int32, images)
        factors = None
        if weights is not None:
            factors = mi.Float(weights.astype(np.float32).ravel())

        # In float64 and in the order of m, so that sums depend neither on threads nor on the order of rays.
        def add(m: Any, total: Any) -> tuple[Any, Any]:
            place = m * row_length + image_number
            ray = mi.UInt32(first_ray + dr.gather(mi.Int32, steps, place))
            landed = (dr.gather(mi.Float, channel, ray) for channel in radiance)
            colour = mi.Color3d(*landed)
            if factors is not None:
                colour *= mi.Float64(dr.gather(mi.Float, factors, place))
            return m + 1, total + colour

        def sum_of(first: Any, end: Any) -> Float:
            nothing = dr.zeros(mi.Color3d, image.size)
            _, total = dr.while_loop((first, nothing), lambda m, _: m < end, add)
            return np.moveaxis(np.array(total).reshape(3, *shape), 0, 1)

        return sum_of(mi.Int32(0), first_half), sum_of(first_half, all_samples)


def _int32(values: NDArray[np.int64]) -> Any:
    return mi.Int32(aligned(values.astype(np.int32).ravel()))


def _finite_mean(values: Float) -> float:
    """The mean of the finite values; NaN if there are none."""
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if len(finite) else math.nan


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
    # Both sides list the samples class by class, the left one in their order and the right one at random within each
    # class. Assigning one to the other permutes the members of every class among themselves.
    orders = np.empty((count, len(classes)), np.int64)
    in_order = np.argsort(classes, kind="stable")
    at_random = np.argsort(classes + random.random(orders.shape), axis=1)
    orders[:, in_order] = at_random
    return orders


def multijitter(cells: Cells, grid: Grid, random: np.random.Generator) -> Cells:
    """Random places (..., n, 2) on an n x n grid, within `cells` (..., n), that use every column and every row once."""
    # Columns of cells, then rows: ranks among all samples, at random within a column or row, are places 0 .. n - 1.
    # They stay within the cell: a grid of c columns has n / c samples in each, so those of column i have the ranks
    # i n / c to (i + 1) n / c - 1, a stripe of the n x n grid.
    parts = np.stack([cells % grid[0], cells // grid[0]])
    # The inverse of a sorting permutation is the rank of each element.
    ranks = np.argsort(np.argsort(parts + random.random(parts.shape)))
    return np.moveaxis(ranks, 0, -1)


class StratifiedSampler(mi.Sampler):  # type: ignore[misc, name-defined]
    """Numbers for rays of the given `pixel` and `sample`. Each pixel has one row of a table of orders per dimension."""

    def __init__(
        self, grid: Grid, shifts: Shifts, pixel: Any, sample: Any, seed: int
    ) -> None:
        super().__init__(mi.Properties())
        n = len(shifts)
        rows = max(_MIN_ROWS, _TABLE_SIZE // (_DIMENSIONS * n))
        table = _table_of_places(grid, shifts, rows, np.random.default_rng(seed))
        self.set_sample_count(n)
        self.table = mi.UInt32(table)
        self.table_size = dr.opaque(mi.UInt32, rows * n)
        self.count = dr.opaque(mi.UInt32, n)
        self.key = dr.opaque(mi.UInt32, seed)
        self.dimension = dr.opaque(mi.UInt32, 0)
        # Each pixel takes a random row, the same in all dimensions.
        random = mi.sample_tea_32(pixel, self.key - _DIMENSION_KEY, _ROUNDS)[0]
        row = random % dr.opaque(mi.UInt32, rows)
        self.position = row * self.count + sample
        self.ray = dr.arange(mi.UInt32, dr.width(pixel))

    def next_1d(self, active: Any = True) -> Any:
        return self._next()[0]

    def next_2d(self, active: Any = True) -> Any:
        return mi.Point2f(*self._next())

    def _next(self) -> list[Any]:
        """Two numbers: random points of the sample's place on the n x n grid, of [0, 1) in later dimensions."""
        in_table = self.dimension < _DIMENSIONS
        index = self.position + self.dimension * self.table_size
        places = dr.gather(mi.UInt32, self.table, index, in_table)
        key = self.key + self.dimension * _DIMENSION_KEY
        numbers = []
        x_and_y = places & 0xFFFF, places >> 16
        random_bits = mi.sample_tea_32(self.ray, key, _ROUNDS)
        for place, bits in zip(x_and_y, random_bits, strict=True):
            unit = mi.Float(bits >> 8) * 2.0**-24
            stratified = (mi.Float(place) + unit) / self.count
            below_one = dr.minimum(stratified, 1 - 2.0**-24)
            numbers.append(dr.select(in_table, below_one, unit))
        self.dimension += 1
        return numbers


def _table_of_places(
    grid: Grid, shifts: Shifts, rows: int, random: np.random.Generator
) -> NDArray[np.uint32]:
    """For each dimension, row and sample, the sample's place x | y << 16 on the n x n grid, flattened."""
    # Samples with equal shifts at all vergences land together.
    n = len(shifts)
    _, together = np.unique(shifts.reshape(n, -1), axis=0, return_inverse=True)
    half = np.arange(n) >= n - n // 2
    tables = []
    for dimension in range(_DIMENSIONS):
        lands = dimension in (_LIGHT, _BOUNCE)  # stratified where samples land
        classes = half + 2 * together.ravel() * lands
        cells = random_cells(grid, random)
        order = shuffle_within(classes, rows, random)
        x, y = np.moveaxis(multijitter(cells[order], grid, random), -1, 0)
        tables.append(x | y << 16)
    return np.ravel(tables).astype(np.uint32)
