"""Traces the paths of a ring once and gathers them at every focus: the kernels of the lens grid.

Sample m of a pixel lands a known whole number of pixels away (`twinlens.rendering.pattern`), so images are gathered,
each pixel adding its samples in their order: no atomics, no rounding to a fixed scale, the same bytes however many
threads there are, and light of any strength. What is not finite stays so, as in Mitsuba's film.
"""

import math
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Camera
from twinlens.camera.warp import on_ring
from twinlens.geometry import Float
from twinlens.rendering.backends import mitsuba
from twinlens.rendering.build import BuiltScene
from twinlens.rendering.law import CameraLaw
from twinlens.rendering.pattern import Pattern, pattern
from twinlens.rendering.radiance import takes
from twinlens.rendering.rings import Ring, Sheaf
from twinlens.rendering.strata import MOST, strata, strata_sampler
from twinlens.rendering.tally import SheafMean
from twinlens.rendering.warp import DrJitMath

OWN_STRATUM = 0.5
"""How far a pixel's own places and aperture points stray from the shared ones, in strata: neighbours see little things
differently, and what is even over the shared ones stays so."""

RAYS_A_PASS = 3 << 23
"""Twelve bytes of radiance each, 300 MB in all: 64 samples of 640x480 pixels are one pattern."""


class Tracer:
    """One camera in one scene. `rays` counts the paths traced so far."""

    def __init__(self, built: BuiltScene, camera: Camera, pose: Float, sampler: str) -> None:
        self.built, self.camera, self.sampler = built, camera, sampler
        self.law = CameraLaw(camera, pose)
        self.rays = 0

    def trace(self, ring: Ring, sheaf: Sheaf, seeds: np.random.SeedSequence) -> SheafMean:
        """The mean radiance through a ring for each vergence of the sheaf."""
        film = _Film(self.camera, sheaf)
        passes = math.ceil(ring.spp / min(MOST, max(1, RAYS_A_PASS // film.pixels)))
        grid = strata(math.ceil(ring.spp / passes))
        shears = [((k - sheaf.middle) * self.camera.fx, (k - sheaf.middle) * self.camera.fy) for k in sheaf.vergences]
        mean = SheafMean(len(shears), self.camera.height, self.camera.width)
        for _ in range(passes):
            shape_seed, seed = (int(word) for word in seeds.spawn(1)[0].generate_state(2))
            shared = pattern(grid, ring.inner, ring.outer, shears, shape_seed)
            white = int(shared.white.sum())
            # The radiance has no name here, so that it is gone before the next pass begins.
            sums = film.gather(
                self._radiance(shared, ring, film, shears, sheaf.middle, seed), shared.shifts, shared.white
            )
            mean.add(sums, (len(shared) - white, white))
            self.rays += film.pixels * len(shared)
        return mean

    def _radiance(
        self,
        shared: Pattern,
        ring: Ring,
        film: "_Film",
        shears: list[tuple[float, float]],
        middle: float,
        seed: int,
    ) -> Any:
        """Radiance of every ray, that of sample m of a pixel at number ``pixel + pixels * m``."""
        mi = mitsuba()
        grained = self.sampler == "multijitter"
        places = strata_sampler(shared.grid)
        if grained:
            places.start(shared, film.pixels, seed)
        else:
            places.start_by_pixel(film.pixels, seed)
        x, y, ax, ay = self._places(places, shared, ring, shears)
        u, v = film.start(places.pixel)
        origin, direction = self.law.ray(u + x, v + y, ax, ay, dr.opaque(mi.Float, middle))
        ray = mi.RayDifferential3f(mi.Ray3f(origin, direction))
        sampler = places if grained else self._mitsuba_sampler(shared, film, seed)
        radiance, valid, _ = self.built.integrator.sample(self.built.mi_scene, sampler, ray, None, True)
        number = places.pixel + dr.opaque(mi.UInt32, film.pixels) * places.sample
        sorted_radiance = dr.zeros(mi.Color3f, film.pixels * len(shared))
        dr.scatter(sorted_radiance, dr.select(valid, radiance, 0.0), number)
        dr.eval(sorted_radiance)
        return sorted_radiance

    def _mitsuba_sampler(self, shared: Pattern, film: "_Film", seed: int) -> Any:
        """Mitsuba's sampler, for the dimensions after the first four."""
        kind = self.sampler if takes(self.sampler, len(shared)) else "independent"
        sampler = mitsuba().load_dict({"type": kind, "sample_count": len(shared)})
        sampler.set_samples_per_wavefront(len(shared))
        sampler.seed(seed, film.pixels * len(shared))
        return sampler

    def _places(
        self, places: Any, shared: Pattern, ring: Ring, shears: list[tuple[float, float]]
    ) -> tuple[Any, Any, Any, Any]:
        """Place from the pixel's corner and aperture point of every ray: its own if that lands where the shared does.

        A Metropolis step from the shared place and point, by an even move of the one and to any point of the other's
        part of a stratum: what was uniform stays so (Metropolis et al., 1953).
        """
        mi = mitsuba()
        columns, rows = (size / OWN_STRATUM for size in shared.grid)
        x, y, across, down, ax, ay = (
            dr.gather(mi.Float, mi.Float(np.ascontiguousarray(values)), places.sample)
            for values in (*shared.film.T, *shared.square.T, *shared.aperture.T)
        )
        move, part = places.next_own(), places.next_own()
        own_x, own_y = x + (move[0] - 0.5) / columns, y + (move[1] - 0.5) / rows
        square = (dr.floor(across * columns) + part[0]) / columns, (dr.floor(down * rows) + part[1]) / rows
        inner2, outer2 = (dr.opaque(mi.Float, radius**2) for radius in (ring.inner, ring.outer))
        own_ax, own_ay = on_ring(*square, inner2, outer2, DrJitMath())
        alike = mi.Bool(True)
        for focus, (along, down_) in enumerate(shears):
            to = [dr.gather(mi.Int32, mi.Int32(shared.shifts[:, focus, axis]), places.sample) for axis in (0, 1)]
            alike &= mi.Int32(dr.floor(own_x + dr.opaque(mi.Float, along) * own_ax)) == to[0]
            alike &= mi.Int32(dr.floor(own_y + dr.opaque(mi.Float, down_) * own_ay)) == to[1]
        pairs = ((own_x, x), (own_y, y), (own_ax, ax), (own_ay, ay))
        return tuple(dr.select(alike, mine, common) for mine, common in pairs)


class _Film:
    """The image with a margin on every side, on which the paths of a sheaf start."""

    def __init__(self, camera: Camera, sheaf: Sheaf) -> None:
        self.image = camera.width, camera.height
        self.margin = sheaf.margin
        self.width, self.height = camera.width + 2 * sheaf.margin[0], camera.height + 2 * sheaf.margin[1]
        self.pixels = self.width * self.height

    def start(self, pixel: Any) -> tuple[Any, Any]:
        """(u, v) of the top left corner of a pixel of the film."""
        mi = mitsuba()
        width = dr.opaque(mi.UInt32, self.width)
        left, top = (dr.opaque(mi.Float, margin + 0.5) for margin in self.margin)
        return mi.Float(pixel % width) - left, mi.Float(pixel // width) - top

    def gather(self, radiance: Any, shifts: NDArray[np.int32], second: NDArray[np.bool_]) -> Float:
        """Sums of what lands on each pixel, (2, F, 3, H, W): over the samples of the first half and of the second."""
        mi = mitsuba()
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
    mi = mitsuba()

    def step(i: Any, red: Any, green: Any, blue: Any) -> tuple[Any, Any, Any, Any]:
        ray = mi.UInt32(start + dr.gather(mi.Int32, steps, i))
        terms = (mi.Float64(dr.gather(mi.Float, radiance[c], ray)) for c in range(3))
        return i + 1, *(total + term for total, term in zip((red, green, blue), terms, strict=True))

    last = dr.opaque(mi.Int32, count)
    zeros = (dr.zeros(mi.Float64, dr.width(start)) for _ in range(3))
    _, *colour = dr.while_loop((mi.Int32(0), *zeros), lambda i, *_: i < last, step)
    dr.eval(colour)
    return colour
