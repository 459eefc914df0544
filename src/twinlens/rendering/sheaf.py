"""Traces the paths of a ring once and gathers them at every focus: the kernels of the lens grid.

Sample m of a pixel lands a known whole number of pixels away (`twinlens.rendering.strata`), so images are gathered,
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
from twinlens.rendering.radiance import takes
from twinlens.rendering.rings import Ring, Sheaf
from twinlens.rendering.strata import Pattern, pattern, strata, strata_sampler
from twinlens.rendering.tally import SheafMean
from twinlens.rendering.warp import DrJitMath

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
        room = max(1, RAYS_A_PASS // film.pixels)
        passes = math.ceil(ring.spp / room)
        grid = strata(math.ceil(ring.spp / passes))
        shears = [((k - sheaf.middle) * self.camera.fx, (k - sheaf.middle) * self.camera.fy) for k in sheaf.vergences]
        mean = SheafMean(len(shears), self.camera.height, self.camera.width)
        for _ in range(passes):
            shape_seed, seed = (int(word) for word in seeds.spawn(1)[0].generate_state(2))
            shared = pattern(grid, ring.inner, ring.outer, shears, shape_seed)
            radiance, strides = self._radiance(shared, ring, film, shears, sheaf.middle, seed)
            white = int(shared.white.sum())
            sums = film.gather(radiance, strides, shared.shifts, shared.white)
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
    ) -> tuple[Any, tuple[int, int]]:
        """Radiance of every ray, and the strides of a ray's number by pixel and by sample."""
        mi = mitsuba()
        grained = self.sampler == "multijitter"
        places = strata_sampler(shared.grid)
        places.start(shared, film.pixels, seed, grained)
        x, y, ax, ay = self._places(places, shared, ring, shears)
        u, v = film.start(places.pixel)
        origin, direction = self.law.ray(u + x, v + y, ax, ay, dr.opaque(mi.Float, middle))
        ray = mi.RayDifferential3f(mi.Ray3f(origin, direction))
        sampler = places if grained else self._mitsuba_sampler(shared, film, seed)
        radiance, valid, _ = self.built.integrator.sample(self.built.mi_scene, sampler, ray, None, True)
        radiance = dr.select(valid, radiance, 0.0)
        dr.eval(radiance)
        return radiance, (1, film.pixels) if grained else (len(shared), 1)

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
        """Place in the pixel and aperture point of every ray: its own where it lands as the shared one, else that."""
        mi = mitsuba()
        x, y, ax, ay = (
            dr.gather(mi.Float, mi.Float(np.ascontiguousarray(values)), places.sample)
            for values in (*shared.film.T, *shared.aperture.T)
        )
        own, square = places.next_in(shared.film_cell), places.next_in(shared.aperture_cell)
        inner2, outer2 = (dr.opaque(mi.Float, radius**2) for radius in (ring.inner, ring.outer))
        own_ax, own_ay = on_ring(square.x, square.y, inner2, outer2, DrJitMath())
        alike = mi.Bool(True)
        for focus, (along, down) in enumerate(shears):
            to = [dr.gather(mi.Int32, mi.Int32(shared.shifts[:, focus, axis]), places.sample) for axis in (0, 1)]
            alike &= mi.Int32(dr.floor(own.x + dr.opaque(mi.Float, along) * own_ax)) == to[0]
            alike &= mi.Int32(dr.floor(own.y + dr.opaque(mi.Float, down) * own_ay)) == to[1]
        pairs = ((own.x, x), (own.y, y), (own_ax, ax), (own_ay, ay))
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

    def gather(
        self, radiance: Any, strides: tuple[int, int], shifts: NDArray[np.int32], second: NDArray[np.bool_]
    ) -> Float:
        """Sums of what lands on each pixel, (2, F, 3, H, W): over the samples of the first half and of the second."""
        mi = mitsuba()
        width, height = self.image
        target = dr.arange(mi.Int32, width * height)
        columns = dr.opaque(mi.Int32, width)
        across, down = target % columns + self.margin[0], target // columns + self.margin[1]
        focuses = shifts.shape[1]
        sums = np.zeros((2, focuses, 3, height, width))
        of_pixel, of_sample = (dr.opaque(mi.Int32, stride) for stride in strides)
        for focus in range(focuses):
            back = mi.Int32(np.ascontiguousarray(shifts[:, focus, 0] + self.width * shifts[:, focus, 1]))
            start = across + dr.opaque(mi.Int32, self.width) * down
            for half in (0, 1):
                members = np.flatnonzero(second == bool(half)).astype(np.int32)
                if not len(members):
                    continue
                found = _sum(radiance, start, of_pixel, of_sample, back, mi.Int32(members), len(members))
                sums[half, focus] = np.array(found).reshape(3, height, width)
        return sums


def _sum(radiance: Any, start: Any, of_pixel: Any, of_sample: Any, back: Any, members: Any, count: int) -> Any:
    """Sum over member samples m of the radiance at ``start - back[m]``, in their order."""
    mi = mitsuba()
    lanes = dr.width(start)

    def step(i: Any, red: Any, green: Any, blue: Any) -> tuple[Any, Any, Any, Any]:
        m = dr.gather(mi.Int32, members, i)
        ray = mi.UInt32((start - dr.gather(mi.Int32, back, m)) * of_pixel + m * of_sample)
        terms = (mi.Float64(dr.gather(mi.Float, radiance[c], ray)) for c in range(3))
        return i + 1, *(total + term for total, term in zip((red, green, blue), terms, strict=True))

    last = dr.opaque(mi.Int32, count)
    zeros = (dr.zeros(mi.Float64, lanes) for _ in range(3))
    _, *colour = dr.while_loop((mi.Int32(0), *zeros), lambda i, *_: i < last, step)
    dr.eval(colour)
    return colour
