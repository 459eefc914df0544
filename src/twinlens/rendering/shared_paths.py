"""Traces the light paths of an annulus once and gathers them for every focus: the kernels of the lens grid.

Sample m of a pixel lands a known integer number of pixels away (`twinlens.rendering.stratified_samples`), so images are
gathered: each pixel adds its samples in order. Gathering needs no atomics and no fixed-point rounding, its bytes do not
depend on the number of threads, and radiance that is not finite stays so, as in Mitsuba's film. Importing this module
sets up the backend.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Camera
from twinlens.camera.aperture import on_ring
from twinlens.geometry import Float
from twinlens.rendering.annuli import ApertureAnnulus, VergenceGroup
from twinlens.rendering.backends import mitsuba
from twinlens.rendering.build import BuiltScene
from twinlens.rendering.radiance import sampler_supports
from twinlens.rendering.ray_generation import DrJitMath, RayGenerator
from twinlens.rendering.stratified_samples import (
    MAX_SAMPLES,
    SamplePattern,
    StratifiedSampler,
    make_pattern,
    stratum_grid,
)

mi = mitsuba()
import drjit as dr  # noqa: E402, Dr.Jit reads DRJIT_LIBLLVM_PATH when it is imported

OWN_JITTER = 0.5
"""Largest deviation of a pixel's film positions and aperture points from the shared ones, in strata. It decorrelates
neighbouring pixels and keeps the stratification of the shared samples."""

RAYS_PER_PASS = 3 << 23
"""300 MB at 12 bytes of radiance per ray; enough for 64 samples of 640x480 pixels in one pass."""


class ImageAccumulator:
    """Mean images over passes, and their variances, for each focus.

    The variance is estimated from two halves of each pass. For independent halves with means a and b of n_a and n_b
    samples, n_a n_b / n^2 (a - b)^2 is the variance of the pass's mean in expectation. The halves are parts of one
    stratified pattern, whose errors partly cancel, so the estimate is an upper bound: exact for noise, and twice the
    variance where stratification works best.
    """

    def __init__(self, focuses: int, height: int, width: int) -> None:
        self.total = np.zeros((focuses, 3, height, width))
        self.squares = np.zeros_like(self.total)
        self.count = 0

    def add(self, halves: NDArray[np.floating], counts: tuple[int, int]) -> None:
        """Add the sums of one pass, (2, F, 3, H, W), over `counts` samples each."""
        first, second = counts
        self.total += halves[0] + halves[1]
        self.count += first + second
        known = first and second
        self.squares += first * second * (halves[0] / first - halves[1] / second) ** 2 if known else math.nan

    def image(self, focus: int) -> Float:
        """The mean image (H, W, 3)."""
        mean: Float = np.moveaxis(self.total[focus] / self.count, 0, -1)
        return mean

    def variance(self, focus: int) -> float:
        """Mean variance over the pixels and channels with finite radiance; NaN for one sample per pixel."""
        squares = self.squares[focus]
        finite = np.isfinite(squares)
        return float(squares[finite].mean()) / self.count**2 if finite.any() else math.nan


class Tracer:
    """Traces the shared paths of one camera in one scene. `rays` counts them."""

    def __init__(self, built: BuiltScene, camera: Camera, pose: Float, sampler: str) -> None:
        self.built, self.camera, self.sampler = built, camera, sampler
        self.generator = RayGenerator(camera, pose)
        self.rays = 0

    def trace(self, annulus: ApertureAnnulus, group: VergenceGroup, seeds: np.random.SeedSequence) -> ImageAccumulator:
        """The mean radiance through an annulus for each vergence of the group."""
        film = PaddedFilm(self.camera, group)
        passes = math.ceil(annulus.spp / min(MAX_SAMPLES, max(1, RAYS_PER_PASS // film.pixels)))
        grid = stratum_grid(math.ceil(annulus.spp / passes))
        shears = [((k - group.middle) * self.camera.fx, (k - group.middle) * self.camera.fy) for k in group.vergences]
        mean = ImageAccumulator(len(shears), self.camera.height, self.camera.width)
        for _ in range(passes):
            shape_seed, seed = (int(word) for word in seeds.spawn(1)[0].generate_state(2))
            shared = make_pattern(grid, annulus.inner, annulus.outer, shears, shape_seed)
            white = int(shared.white.sum())
            # The radiance is not bound to a name, so that its memory is freed before the next pass.
            sums = film.gather(
                self._radiance(shared, annulus, film, shears, group.middle, seed), shared.shifts, shared.white
            )
            mean.add(sums, (len(shared) - white, white))
            self.rays += film.pixels * len(shared)
        return mean

    def _radiance(
        self,
        shared: SamplePattern,
        annulus: ApertureAnnulus,
        film: "PaddedFilm",
        shears: list[tuple[float, float]],
        middle: float,
        seed: int,
    ) -> Any:
        """Radiance of every ray; sample m of a pixel has the index ``pixel + pixels * m``."""
        is_stratified = self.sampler == "multijitter"
        places = StratifiedSampler(*shared.grid)
        if is_stratified:
            places.start(shared, film.pixels, seed)
        else:
            places.start_by_pixel(film.pixels, seed)
        x, y, ax, ay = self._film_and_aperture(places, shared, annulus, shears)
        u, v = film.start(places.pixel)
        origin, direction = self.generator.ray(u + x, v + y, ax, ay, dr.opaque(mi.Float, middle))
        ray = mi.RayDifferential3f(mi.Ray3f(origin, direction))
        sampler = places
        if not is_stratified:  # Mitsuba's sampler, for the dimensions after film and aperture
            kind = self.sampler if sampler_supports(self.sampler, len(shared)) else "independent"
            sampler = mi.load_dict({"type": kind, "sample_count": len(shared)})
            sampler.set_samples_per_wavefront(len(shared))
            sampler.seed(seed, film.pixels * len(shared))
        radiance, valid, _ = self.built.integrator.sample(self.built.mi_scene, sampler, ray, None, True)
        number = places.pixel + dr.opaque(mi.UInt32, film.pixels) * places.sample
        sorted_radiance = dr.zeros(mi.Color3f, film.pixels * len(shared))
        dr.scatter(sorted_radiance, dr.select(valid, radiance, 0.0), number)
        dr.eval(sorted_radiance)
        return sorted_radiance

    def _film_and_aperture(
        self, places: Any, shared: SamplePattern, annulus: ApertureAnnulus, shears: list[tuple[float, float]]
    ) -> tuple[Any, Any, Any, Any]:
        """Film position in the pixel and aperture point of every ray.

        Each ray deviates from the shared sample, unless it would then land in another pixel at some focus. This is a
        Metropolis step with a symmetric proposal, which keeps uniform distributions uniform (Metropolis et al., 1953).
        """
        columns, rows = (size / OWN_JITTER for size in shared.grid)
        x, y, across, down, ax, ay = (
            dr.gather(mi.Float, mi.Float(np.ascontiguousarray(values)), places.sample)
            for values in (*shared.film.T, *shared.square.T, *shared.aperture.T)
        )
        move, part = places.next_independent(), places.next_independent()
        own_x, own_y = x + (move[0] - 0.5) / columns, y + (move[1] - 0.5) / rows
        square = (dr.floor(across * columns) + part[0]) / columns, (dr.floor(down * rows) + part[1]) / rows
        inner2, outer2 = (dr.opaque(mi.Float, radius**2) for radius in (annulus.inner, annulus.outer))
        own_ax, own_ay = on_ring(*square, inner2, outer2, DrJitMath())
        alike = mi.Bool(True)
        for focus, (along, down_) in enumerate(shears):
            to = [dr.gather(mi.Int32, mi.Int32(shared.shifts[:, focus, axis]), places.sample) for axis in (0, 1)]
            alike &= mi.Int32(dr.floor(own_x + dr.opaque(mi.Float, along) * own_ax)) == to[0]
            alike &= mi.Int32(dr.floor(own_y + dr.opaque(mi.Float, down_) * own_ay)) == to[1]
        pairs = ((own_x, x), (own_y, y), (own_ax, ax), (own_ay, ay))
        return tuple(dr.select(alike, mine, common) for mine, common in pairs)


class PaddedFilm:
    """The image with a margin on every side, from which the paths of a group start."""

    def __init__(self, camera: Camera, group: VergenceGroup) -> None:
        self.image = camera.width, camera.height
        self.margin = group.margin
        self.width, self.height = group.film_size(camera)
        self.pixels = self.width * self.height

    def start(self, pixel: Any) -> tuple[Any, Any]:
        """(u, v) of the top left corner of a pixel of the film."""
        width = dr.opaque(mi.UInt32, self.width)
        left, top = (dr.opaque(mi.Float, margin + 0.5) for margin in self.margin)
        return mi.Float(pixel % width) - left, mi.Float(pixel // width) - top

    def gather(self, radiance: Any, shifts: NDArray[np.int32], second: NDArray[np.bool_]) -> Float:
        """Sums (2, F, 3, H, W) of the radiance landing on each pixel, over the first and the second half of samples."""
        width, height = self.image
        target = dr.arange(mi.Int32, width * height)
        columns = dr.opaque(mi.Int32, width)
        across, down = target % columns + self.margin[0], target // columns + self.margin[1]
        start = across + dr.opaque(mi.Int32, self.width) * down
        back = self.pixels * np.arange(len(shifts))[:, None] - shifts[..., 0] - self.width * shifts[..., 1]
        sums = np.zeros((2, shifts.shape[1], 3, height, width))
        for half, focus in np.ndindex(sums.shape[:2]):
            steps = back[second == bool(half), focus].astype(np.int32)
            if len(steps):
                sums[half, focus] = np.array(_sum(radiance, start, mi.Int32(steps), len(steps))).reshape(
                    3, height, width
                )
        return sums


def _sum(radiance: Any, start: Any, steps: Any, count: int) -> Any:
    """Sum over the steps of the radiance at ``start + step``, in their order."""

    def step(i: Any, red: Any, green: Any, blue: Any) -> tuple[Any, Any, Any, Any]:
        ray = mi.UInt32(start + dr.gather(mi.Int32, steps, i))
        terms = (mi.Float64(dr.gather(mi.Float, radiance[c], ray)) for c in range(3))
        return i + 1, *(total + term for total, term in zip((red, green, blue), terms, strict=True))

    last = dr.opaque(mi.Int32, count)
    zeros = (dr.zeros(mi.Float64, dr.width(start)) for _ in range(3))
    _, *colour = dr.while_loop((mi.Int32(0), *zeros), lambda i, *_: i < last, step)
    dr.eval(colour)
    return colour
