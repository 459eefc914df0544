"""Irradiance of a scene's surfaces in a grid of cells, from few light paths.

Much of the noise of an image is that of light between surfaces: a path that leaves a first surface meets a second one,
which is lit by a third one, and so on. Irradiance varies slowly, and a second surface is seen through the diffuse
reflection of the first, which averages over all directions. So the mean irradiance of a cell can stand for that of a
point in it: path space filtering (Binder, Fricke and Keller, Massively Parallel Path Space Filtering, 2019).

Paths from the cameras are reflected in random directions. Each surface after the first gives a sample of its cell: the
irradiance directly from lights, sampled on the lights and in the path's next direction, and the cell of the next
surface, with its reflectance. The irradiance after several reflections follows from that of the cells by iteration.
There is a table for each number of reflections, so that `max_depth` means what it does without the cache, except that
mirrors and glass between two cells do not count.

Importing this module sets up the backend.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.geometry import Float
from twinlens.rendering.backends import mitsuba
from twinlens.rendering.tracing import MAX_SPECULAR

mi = mitsuba()
import drjit as dr  # noqa: E402, Dr.Jit reads DRJIT_LIBLLVM_PATH when it is imported

PATHS = 1 << 16
"""Paths of a cache, for all cameras together."""

_SURFACES = 5  # on each path, without mirrors and glass
_CELLS = 64  # along the longest side of a box
_OUTSIDE = 1.0  # percentage of the surfaces beyond each side of the box
_LEAST_SAMPLES = 4  # of a cell
_FACES = 6  # directions of normals
_LAYERS = 8  # of a cell along the normal: surfaces that face the same way and are close to each other share no light
_CONVERGED = 1e-4  # last change of the irradiance, relative to its mean
_MOST_BOUNCES = 256
_FEW_BOUNCES = 8  # after more, a change that grows will not converge
_NOT_TRACED, _NOTHING, _SURFACE = 0, 1, 2  # what paths meet
_NOWHERE, _UNKNOWN = (
    -1,
    -2,
)  # in the place of a cell: nothing there; a surface without a cell, or not traced


@dataclass(frozen=True, eq=False)
class _Paths:
    """What path n meets after k surfaces that scatter light, arrays (K, N, ...).

    reflectance : share of the light on the surface that leaves it towards the surface before.
    arrival : share of the light that passes the mirrors and glass between the two.
    emission : radiance of the lights that these show.
    irradiance : directly from lights; not computed for the last surface.
    """

    met: NDArray[np.uint32]
    position: NDArray[np.float32]
    normal: NDArray[np.float32]
    reflectance: NDArray[np.float32]
    arrival: NDArray[np.float32]
    emission: NDArray[np.float32]
    irradiance: NDArray[np.float32]


class IrradianceCache:
    """Mean irradiance of the cells of a scene.

    rays : rays from the cameras.
    lamps : emitters that are not in the scene.
    bounces : the most that are needed; -1 is no limit.
    """

    def __init__(
        self, scene: Any, rays: Any, seed: int, lamps: Sequence[Any], bounces: int
    ) -> None:
        paths = _trace(scene, rays, seed, lamps)
        on_surface = paths.met == _SURFACE
        # First surfaces are no samples: cameras choose them. Neither are last ones: nothing is known of what they face.
        middle = on_surface[1:-1]
        self._set_bounds(paths.position[1:-1][middle])

        # The number of the box of each surface, then that of its cell: boxes that have a sample, in order.
        places, normals = (
            mi.Vector3f(of.reshape(-1, 3).T) for of in (paths.position, paths.normal)
        )
        inside, boxes = (
            np.array(of).reshape(paths.met.shape) for of in self._box(places, normals)
        )
        inside &= on_surface
        used, cells, samples = np.unique(
            boxes[1:-1][inside[1:-1]], return_inverse=True, return_counts=True
        )
        count = max(len(used), 1)  # Dr.Jit does not read from empty arrays
        cell = np.full(boxes.shape, _UNKNOWN)
        cell[1:-1][inside[1:-1]] = cells
        # A last surface may be in a box without samples.
        last = np.minimum(np.searchsorted(used, boxes[-1]), count - 1)
        if len(used):
            cell[-1] = np.where(inside[-1] & (used[last] == boxes[-1]), last, _UNKNOWN)
        tables = _tables(paths, cell, count, bounces)

        # Paths look up the row of a box: 0 where too few samples know its irradiance, else 1 + its cell.
        sampled = np.flatnonzero(samples >= _LEAST_SAMPLES)
        rows = np.zeros(math.prod(self._counts) * _FACES * _LAYERS, np.uint32)
        rows[used[sampled]] = 1 + sampled
        self._rows = mi.UInt32(rows)
        self._tables = mi.Float(tables.astype(np.float32).ravel())
        self._count = dr.opaque(mi.UInt32, count)
        self._top = dr.opaque(mi.UInt32, len(tables) - 1)

    def _set_bounds(self, positions: NDArray[np.float32]) -> None:
        """Set the grid around positions (N, 3), but for the few that lie far outside, with a margin of one cell."""
        if not len(positions):
            positions = np.zeros((1, 3), np.float32)
        low, high = np.percentile(
            positions.astype(np.float64), (_OUTSIDE, 100 - _OUTSIDE), axis=0
        )
        size = max(float((high - low).max()) / _CELLS, 1e-6)
        self._counts = [int(n) for n in np.ceil((high - low) / size).astype(int) + 2]
        # Opaque values are no literals of kernels, which are then the same for all scenes.
        self._low = [dr.opaque(mi.Float, value) for value in low - size]
        self._size = dr.opaque(mi.Float, size)
        self._shape = [dr.opaque(mi.UInt32, n) for n in self._counts]

    def _box(self, place: Any, normal: Any) -> tuple[Any, Any]:
        """Whether a surface is in a cell, and its number: of the cell, the direction of its normal, and its layer."""
        places = [(place[i] - self._low[i]) / self._size for i in range(3)]
        x, y, z = (dr.floor(at) for at in places)
        inside = mi.Bool(True)
        for at, count in zip((x, y, z), self._shape, strict=True):
            inside &= (at >= 0) & (at < mi.Float(count))
        # The offset of the surface's plane from the middle of the cell, in cells: within half a diagonal, sqrt(3) / 2.
        offset = dr.dot(normal, mi.Vector3f(*places) - mi.Vector3f(x, y, z) - 0.5)
        layer = mi.UInt32(
            dr.clip(_LAYERS * (offset / math.sqrt(3) + 0.5), 0, _LAYERS - 1)
        )
        row = mi.UInt32(z) * self._shape[1] + mi.UInt32(y)
        cell = row * self._shape[0] + mi.UInt32(x)
        return inside, (cell * _FACES + _face(normal)) * _LAYERS + layer

    def look_up(
        self, si: Any, ray: Any, drawn: Any, bounces: Any, active: Any
    ) -> tuple[Any, Any]:
        """Whether the irradiance at `si` is known, and its value after at most `bounces`.

        The place is moved by up to half a cell along the surface, so that cells do not show. Surfaces nearer to the
        ray's origin than a cell are not known.
        """
        normal = _facing(si, ray)
        frame = mi.Frame3f(normal)
        place = si.p + self._size * (
            (drawn.x - 0.5) * frame.s + (drawn.y - 0.5) * frame.t
        )
        inside, box = self._box(place, normal)
        is_cached = active & inside & (si.t > self._size)
        row = dr.gather(mi.UInt32, self._rows, box, is_cached)
        is_cached &= row > 0
        row = dr.minimum(bounces, self._top) * self._count + row - 1
        return is_cached, dr.gather(mi.Color3f, self._tables, row, is_cached)


def _trace(scene: Any, rays: Any, seed: int, lamps: Sequence[Any]) -> _Paths:
    """Paths from `rays`, whose directions after each surface that scatters light are cosine-weighted.

    The irradiance E of a surface is the integral of L cos(theta) over the hemisphere. It is estimated from the lights
    alone, with two techniques weighted by the power heuristic: a point of a light, and the path's own next direction,
    whose density cos(theta) / pi makes the estimate pi L.
    """
    count = dr.width(rays)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, count)
    kinds = dr.zeros(mi.UInt32, _SURFACES * count)
    *vectors, lit = [dr.zeros(mi.Float, 3 * _SURFACES * count) for _ in range(6)]
    path, paths = dr.arange(mi.UInt32, count), dr.opaque(mi.UInt32, count)

    def step(
        active: Any,
        sampler: Any,
        ray: Any,
        last: Any,
        arrival: Any,
        emission: Any,
        passed: Any,
        k: Any,
    ) -> tuple[Any, ...]:
        """One surface. `passed` counts the mirrors and glass since the last one that scatters light.

        `last`: the last scattering surface, the pdf of the ray's direction there, and the light sampled there.
        """
        si = scene.ray_intersect(ray, mi.RayFlags.All, False, active)
        # Light that the path meets: after mirrors and glass it belongs to what they show, straight after a surface
        # that scatters light it is the second estimate of that surface's irradiance.
        shines = mi.DirectionSample3f(scene, si, last[0])
        shown = arrival * shines.emitter.eval(si)
        emission = emission + dr.select(active & (passed > 0), shown, 0.0)
        follows = active & (k > 0) & (passed == 0)
        density = scene.pdf_emitter_direction(last[0], shines, follows)
        by_chance = math.pi * shown * mis(last[1], density)
        dr.scatter(
            lit, mi.Color3f(last[2] + by_chance), (k - 1) * paths + path, follows
        )
        # Whether the surface scatters light, or is a mirror or glass that the path passes.
        there = active & si.is_valid()
        bsdf, context, normal = si.bsdf(), mi.BSDFContext(), _facing(si, ray)
        chosen, factor = bsdf.sample(
            context, si, sampler.next_1d(), sampler.next_2d(), there
        )
        onwards = mi.BSDFFlags.Transmission | mi.BSDFFlags.Null
        flags = bsdf.flags()
        is_glass = mi.has_flag(flags, mi.BSDFFlags.Transmission) & ~mi.has_flag(
            flags, mi.BSDFFlags.Diffuse
        )
        scatters = mi.has_flag(flags, mi.BSDFFlags.Smooth) & ~is_glass
        scatters &= ~mi.has_flag(chosen.sampled_type, onwards)
        on_surface = there & scatters
        # The first estimate: a point of a light. Projectors can only be found so.
        ds, light = scene.sample_emitter_direction(
            si, sampler.next_2d(), True, on_surface
        )
        cosine = dr.maximum(dr.dot(ds.d, normal), 0.0)
        weight = dr.select(ds.delta, 1.0, mis(ds.pdf, cosine / math.pi))
        irradiance = dr.select(ds.pdf != 0, light * cosine * weight, 0.0)
        for lamp in lamps:
            ds, light = lamp.sample_direction(si, sampler.next_2d(), on_surface)
            dark = scene.ray_test(si.spawn_ray_to(ds.p), on_surface)
            irradiance += dr.select(
                dark, 0.0, light * dr.maximum(dr.dot(ds.d, normal), 0.0)
            )

        # What is kept of the surface, in the row of its number on the path.
        after = arrival * factor
        passes = there & ~scatters & dr.any(after != 0)
        ends = active & ~on_surface & ~passes
        row, met = (
            k * paths + path,
            dr.select(on_surface, mi.UInt32(_SURFACE), mi.UInt32(_NOTHING)),
        )
        dr.scatter(kinds, met, row, on_surface | ends)
        for buffer, value in zip(
            vectors, (si.p, normal, factor, arrival, emission), strict=True
        ):
            dr.scatter(buffer, mi.Color3f(value), row, on_surface | ends)

        # The next ray: from a surface into the hemisphere, from a mirror or glass where its BSDF sent it.
        spread = mi.warp.square_to_cosine_hemisphere(sampler.next_2d())
        ray = si.spawn_ray(
            dr.select(
                on_surface, mi.Frame3f(normal).to_world(spread), si.to_world(chosen.wo)
            )
        )
        here = (
            mi.Interaction3f(si),
            mi.warp.square_to_cosine_hemisphere_pdf(spread),
            mi.Spectrum(irradiance),
        )
        last = dr.select(on_surface, here, last)
        arrival, emission = (
            dr.select(on_surface, 1.0, after),
            dr.select(on_surface, 0.0, emission),
        )
        passed, k = (
            dr.select(on_surface, 0, passed + 1),
            dr.select(on_surface, k + 1, k),
        )
        active = (on_surface & (k < _SURFACES)) | (passes & (passed < MAX_SPECULAR))
        return active, sampler, ray, last, arrival, emission, passed, k

    none = dr.zeros(mi.Interaction3f), mi.Float(1.0), mi.Spectrum(0.0)
    start = (
        mi.Bool(True),
        sampler,
        mi.Ray3f(rays),
        none,
        mi.Spectrum(1.0),
        mi.Spectrum(0.0),
    )
    dr.while_loop((*start, mi.UInt32(0), mi.UInt32(0)), lambda active, *_: active, step)
    dr.eval(kinds, vectors, lit)
    arrays = (
        np.nan_to_num(np.array(buffer)).reshape(_SURFACES, count, 3)
        for buffer in (*vectors, lit)
    )
    return _Paths(np.array(kinds).reshape(_SURFACES, count), *arrays)


def _tables(paths: _Paths, cell: NDArray[np.int64], count: int, bounces: int) -> Float:
    """The irradiance (B + 1, C, 3) of cells after at most 0, 1, ... `bounces`; `cell` (K, N) are those of surfaces.

    With the mean over the samples of a cell, the next surface y of each, and what of its light arrives,

        E_b = E_0 + mean(pi emission + arrival reflectance E_(b-1)(cell of y)),    E_0 directly from lights

    Ends where more bounces add nothing, and where they add more and more: reflectances are those of single samples, so
    that the light between two cells of few samples may grow without limit.
    """

    def means(values: Float, of: NDArray[np.int64]) -> Float:
        sums = [np.bincount(of, channel, count) for channel in values.T]
        samples = np.maximum(np.bincount(of, minlength=count), 1)
        return np.stack(sums, axis=-1) / samples[:, None]

    here = cell[1:-1]
    is_sample = here >= 0
    direct = paths.irradiance[1:-1][is_sample].astype(np.float64)
    tables = [means(direct, here[is_sample])]
    # Samples whose next surface has no cell are left out: their light between surfaces is not known.
    after = np.where(paths.met[2:] == _NOTHING, _NOWHERE, cell[2:])
    is_sample &= after != _UNKNOWN
    here, after = here[is_sample], after[is_sample]
    lights = math.pi * paths.emission[2:][is_sample].astype(np.float64)
    gains = np.where(
        (after >= 0)[:, None], (paths.arrival * paths.reflectance)[2:][is_sample], 0.0
    )
    least = _CONVERGED * tables[0].mean()
    before = math.inf
    for bounce in range(bounces if 0 <= bounces < _MOST_BOUNCES else _MOST_BOUNCES):
        light = tables[0] + means(lights + gains * tables[-1][after], here)
        change = np.abs(light - tables[-1]).max()
        if bounce >= _FEW_BOUNCES and change > before:
            break
        tables.append(light)
        if change <= least:
            break
        before = change
    return np.stack(tables)


def mis(density: Any, density_of_other: Any) -> Any:
    """The weight of a sample that one of two techniques drew, from its densities in both: the power heuristic.

    A light seen from its edge has an infinite density and sends nothing.
    """
    square = density * density
    weight = square / (square + density_of_other * density_of_other)
    return dr.select(dr.isfinite(weight), weight, 0.0)


def _facing(si: Any, ray: Any) -> Any:
    """The geometric normal on the side where the ray comes from."""
    return dr.select(dr.dot(si.n, ray.d) > 0, -si.n, si.n)


def _face(normal: Any) -> Any:
    """Which of the six axes is nearest to the normal."""
    size = dr.abs(normal)
    is_x, is_z = (size.x >= size.y) & (size.x >= size.z), size.z > size.y
    along = dr.select(is_x, normal.x, dr.select(is_z, normal.z, normal.y))
    axis = dr.select(is_x, mi.UInt32(0), dr.select(is_z, mi.UInt32(4), mi.UInt32(2)))
    return axis + dr.select(along < 0, mi.UInt32(1), mi.UInt32(0))
