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
from twinlens.rendering.cut_outs import CutOuts, arriving
from twinlens.rendering.tracing import MAX_SPECULAR, is_null

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
_NOWHERE = -1  # in the place of a cell: nothing there
_UNKNOWN = -2  # in the place of a cell: a surface without a cell, or not traced


@dataclass(frozen=True, eq=False)
class _Paths:
    """What path n meets after k surfaces that scatter light, arrays (K, N, ...).

    distance : from the start of the ray that met the surface.
    reflectance : share of the light on the surface that leaves it towards the surface before.
    arrival : share of the light that passes the mirrors and glass between the two.
    emission : radiance of the lights that these show.
    irradiance : directly from lights; not computed for the last surface.
    """

    met: NDArray[np.uint32]
    distance: NDArray[np.float32]
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
    openings : the cut-outs of the scene.
    """

    def __init__(
        self,
        scene: Any,
        rays: Any,
        seed: int,
        lamps: Sequence[Any],
        bounces: int,
        openings: CutOuts | None = None,
    ) -> None:
        paths = _trace(scene, rays, seed, lamps, openings)
        # First surfaces are no samples: cameras choose them. Neither are last ones: nothing is known of what they face.
        is_sample = paths.met[1:-1] == _SURFACE
        self._set_bounds(paths.position[1:-1][is_sample])
        boxes, cell, samples = self._cells_of(paths)
        tables = _tables(paths, cell, len(samples), bounces)

        # Paths look up the row of a box: 0 where too few samples know its irradiance, else 1 + its cell.
        is_far = boxes % 2 == 0
        sampled = np.flatnonzero((samples >= _LEAST_SAMPLES) & is_far)
        rows = np.zeros(math.prod(self._counts) * _FACES * _LAYERS, np.uint32)
        rows[boxes[sampled] // 2] = 1 + sampled
        self._rows = mi.UInt32(rows)
        self._tables = mi.Float(tables.astype(np.float32).ravel())
        self._count = dr.opaque(mi.UInt32, len(samples))
        self._top = dr.opaque(mi.UInt32, len(tables) - 1)

    def _cells_of(
        self, paths: _Paths
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """The cells, in order: boxes that have a sample, apart for those met from nearby and from further away.

        Returns twice the boxes of the cells (C,), plus 1 for samples from nearby; the cell of each surface (K, N); and
        the numbers of samples of the cells (C,). Without any, there is one cell without samples: Dr.Jit does not read
        from empty arrays.
        """
        inside, boxes = (
            np.array(part).reshape(paths.met.shape)
            for part in self._box(_vectors(paths.position), _vectors(paths.normal))
        )
        inside &= paths.met == _SURFACE
        # Surfaces that are met from nearby are in corners or below something, where less light arrives. Looked up are
        # only those that are met from further away, so that the two have cells of their own.
        boxes = 2 * boxes.astype(np.int64) + self._is_near(paths.distance)
        is_sample = inside[1:-1]
        used, cells, samples = np.unique(
            boxes[1:-1][is_sample], return_inverse=True, return_counts=True
        )
        cell = np.full(boxes.shape, _UNKNOWN)
        if not len(used):
            return np.zeros(1, np.int64), cell, np.zeros(1, np.int64)
        cell[1:-1][is_sample] = cells
        # A last surface is in a cell too, unless its box has no samples.
        last = np.minimum(np.searchsorted(used, boxes[-1]), len(used) - 1)
        has_cell = inside[-1] & (used[last] == boxes[-1])
        cell[-1] = np.where(has_cell, last, _UNKNOWN)
        return used, cell, samples

    def _is_near(self, distance: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Whether surfaces are nearer than a cell to where the ray started that met them: not looked up."""
        return distance <= float(np.array(self._size)[0])

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


@dataclass
class _Departure:
    """The last surface of paths that scattered light.

    point : the interaction there.
    pdf : density, per solid angle, of the direction in which the path went on.
    light : the irradiance there from points of lights, the first of its two estimates.
    """

    point: Any
    pdf: Any
    light: Any


@dataclass
class _Walk:
    """Paths on the way to their next surface: the state of Dr.Jit's loop.

    active : whether the path goes on.
    ray : the path's next ray, in the world.
    last : the last surface that scattered light; meaningless before the first one.
    arrival : share of the light that the mirrors and glass since then let through.
    emission : radiance of the lights that these show.
    passed : the number of mirrors and glass since then.
    scattered : the number of surfaces that scattered light.
    """

    active: Any
    sampler: Any
    ray: Any
    last: _Departure
    arrival: Any
    emission: Any
    passed: Any
    scattered: Any


@dataclass(frozen=True, eq=False)
class _Met:
    """What paths meet next: a surface that scatters light, or a mirror or glass that they pass, or neither.

    si, normal : the interaction, and the geometric normal on the side where the path comes from.
    sample, factor : the direction that the BSDF draws there, and BSDF * cosine / pdf in it: the reflectance.
    """

    si: Any
    normal: Any
    sample: Any
    factor: Any
    scatters: Any
    passes: Any


def _trace(
    scene: Any, rays: Any, seed: int, lamps: Sequence[Any], openings: CutOuts | None
) -> _Paths:
    """Paths from `rays`, whose directions after each surface that scatters light are cosine-weighted.

    The irradiance E of a surface is the integral of L cos(theta) over the hemisphere. It is estimated from the lights
    alone, with two techniques weighted by the power heuristic: a point of a light, and the path's own next direction,
    whose density cos(theta) / pi makes the estimate pi L.
    """
    count = dr.width(rays)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, count)
    tracer = _Tracer(scene, lamps, count, openings)
    start = _Walk(
        active=mi.Bool(True),
        sampler=sampler,
        ray=mi.Ray3f(rays),
        last=_Departure(dr.zeros(mi.Interaction3f), mi.Float(1.0), mi.Spectrum(0.0)),
        arrival=mi.Spectrum(1.0),
        emission=mi.Spectrum(0.0),
        passed=mi.UInt32(0),
        scattered=mi.UInt32(0),
    )
    dr.while_loop((start,), lambda walk: walk.active, lambda walk: (tracer.step(walk),))
    return tracer.paths()


class _Tracer:
    """Follows paths through a scene and keeps what they meet, in Dr.Jit arrays: row k N + n for surface k of path n."""

    def __init__(
        self, scene: Any, lamps: Sequence[Any], count: int, openings: CutOuts | None
    ) -> None:
        self.scene, self.lamps, self.count = scene, lamps, count
        self.openings = openings
        self.kinds = dr.zeros(mi.UInt32, _SURFACES * count)
        self.distances = dr.zeros(mi.Float, _SURFACES * count)
        *vectors, lit = [dr.zeros(mi.Float, 3 * _SURFACES * count) for _ in range(6)]
        self.vectors, self.lit = vectors, lit
        # The number of paths is opaque, so that kernels do not depend on it.
        self.row_length = dr.opaque(mi.UInt32, count)
        self.path = dr.arange(mi.UInt32, count)

    def step(self, walk: _Walk) -> _Walk:
        """The paths after their next surface."""
        si = self.scene.ray_intersect(walk.ray, mi.RayFlags.All, False, walk.active)
        emission = self._meet_light(walk, si)
        met = _met(walk, si)
        light = self._light_of_points(met, walk.sampler)
        self._keep(walk, met, emission)
        onward = _onward(walk, met, light, emission)
        if self.openings is not None:
            # The light behind a cut-out belongs to the surface before it, not to what glass shows.
            is_cut_out = met.passes & is_null(met.sample)
            is_cut_out &= self.openings.lets_through(met.si.bsdf())
            onward.passed = dr.select(is_cut_out, walk.passed, onward.passed)
        return onward

    def _row(self, surface: Any) -> Any:
        return surface * self.row_length + self.path

    def _meet_light(self, walk: _Walk, si: Any) -> Any:
        """The `emission` of the paths, with that of the light which they meet.

        Light that is met after mirrors and glass belongs to what these show. Light that is met straight after a surface
        that scatters light is the second estimate of that surface's irradiance: pi L, by the density cos(theta) / pi
        of the direction. The sum of both estimates is kept here, where the second one is first known.
        """
        last = walk.last
        shines = mi.DirectionSample3f(self.scene, si, last.point)
        shown = walk.arrival * shines.emitter.eval(si)
        is_behind_glass = walk.active & (walk.passed > 0)
        emission = walk.emission + dr.select(is_behind_glass, shown, 0.0)
        follows = walk.active & (walk.scattered > 0) & (walk.passed == 0)
        density = self.scene.pdf_emitter_direction(last.point, shines, follows)
        by_chance = math.pi * shown * mis(last.pdf, density)
        irradiance = mi.Color3f(last.light + by_chance)
        dr.scatter(self.lit, irradiance, self._row(walk.scattered - 1), follows)
        return emission

    def _light_of_points(self, met: _Met, sampler: Any) -> Any:
        """The first estimate of the irradiance: L cos(theta) / pdf of a point of a light, weighted, and of each lamp.

        Projectors, the lamps, can only be found so: their weight is 1, and each takes one shadow ray.
        """
        si, normal = met.si, met.normal
        ds, light = self.scene.sample_emitter_direction(
            si, sampler.next_2d(), False, met.scatters
        )
        cosine = dr.maximum(dr.dot(ds.d, normal), 0.0)
        weight = dr.select(ds.delta, 1.0, mis(ds.pdf, cosine / math.pi))
        is_lit = met.scatters & (ds.pdf != 0) & (cosine > 0)
        light = light * cosine * weight
        irradiance = from_emitter(self.scene, ds, si, light, is_lit, self.openings)
        for lamp in self.lamps:
            ds, light = lamp.sample_direction(si, sampler.next_2d(), met.scatters)
            cosine = dr.maximum(dr.dot(ds.d, normal), 0.0)
            irradiance += arriving(
                self.scene, si, ds.p, light * cosine, met.scatters, self.openings
            )
        return irradiance

    def _keep(self, walk: _Walk, met: _Met, emission: Any) -> None:
        """Keep a surface that scatters light, or the path's end, in its row."""
        ends = walk.active & ~met.scatters & ~met.passes
        row, kept = self._row(walk.scattered), met.scatters | ends
        kind = dr.select(met.scatters, mi.UInt32(_SURFACE), mi.UInt32(_NOTHING))
        dr.scatter(self.kinds, kind, row, kept)
        dr.scatter(self.distances, met.si.t, row, kept)
        values = (met.si.p, met.normal, met.factor, walk.arrival, emission)
        for buffer, value in zip(self.vectors, values, strict=True):
            dr.scatter(buffer, mi.Color3f(value), row, kept)

    def paths(self) -> _Paths:
        """What has been kept, as NumPy arrays."""
        buffers = [*self.vectors, self.lit]
        dr.eval(self.kinds, self.distances, buffers)
        shape = _SURFACES, self.count
        arrays = (
            np.nan_to_num(np.array(buffer)).reshape(*shape, 3) for buffer in buffers
        )
        kinds = np.array(self.kinds).reshape(shape)
        distances = np.array(self.distances).reshape(shape)
        return _Paths(kinds, distances, *arrays)


def _met(walk: _Walk, si: Any) -> _Met:
    """What the rays of the paths hit, and whether it scatters light or is a mirror or glass that they pass.

    Rough glass scatters light, but not in the directions of a hemisphere: it counts as glass, as do openings.
    """
    is_there = walk.active & si.is_valid()
    bsdf = si.bsdf()
    normal = _facing(si, walk.ray)
    sample, factor = bsdf.sample(
        mi.BSDFContext(), si, walk.sampler.next_1d(), walk.sampler.next_2d(), is_there
    )
    flags, onwards = bsdf.flags(), mi.BSDFFlags.Transmission | mi.BSDFFlags.Null
    transmits = mi.has_flag(flags, mi.BSDFFlags.Transmission)
    is_glass = transmits & ~mi.has_flag(flags, mi.BSDFFlags.Diffuse)
    goes_through = mi.has_flag(sample.sampled_type, onwards)
    scatters = mi.has_flag(flags, mi.BSDFFlags.Smooth) & ~is_glass & ~goes_through
    passes = is_there & ~scatters & dr.any(walk.arrival * factor != 0)
    return _Met(si, normal, sample, factor, is_there & scatters, passes)


def _onward(walk: _Walk, met: _Met, light: Any, emission: Any) -> _Walk:
    """The paths on their next ray: from a surface into the hemisphere, else where the BSDF sent it.

    light : the first estimate of the irradiance of the surface, kept until the next ray gives the second one.
    """
    si, scatters = met.si, met.scatters
    local = mi.warp.square_to_cosine_hemisphere(walk.sampler.next_2d())
    spread = mi.Frame3f(met.normal).to_world(local)
    ray = si.spawn_ray(dr.select(scatters, spread, si.to_world(met.sample.wo)))
    pdf = mi.warp.square_to_cosine_hemisphere_pdf(local)
    here = _Departure(mi.Interaction3f(si), pdf, mi.Spectrum(light))
    passed = dr.select(scatters, 0, walk.passed + 1)
    scattered = dr.select(scatters, walk.scattered + 1, walk.scattered)
    goes_on = scatters & (scattered < _SURFACES)
    passes = met.passes & (passed < MAX_SPECULAR)
    return _Walk(
        active=goes_on | passes,
        sampler=walk.sampler,
        ray=ray,
        last=dr.select(scatters, here, walk.last),
        arrival=dr.select(scatters, 1.0, walk.arrival * met.factor),
        emission=dr.select(scatters, 0.0, emission),
        passed=passed,
        scattered=scattered,
    )


def _tables(paths: _Paths, cell: NDArray[np.int64], count: int, bounces: int) -> Float:
    """The irradiance (B + 1, C, 3) of cells after at most 0, 1, ... `bounces`; `cell` (K, N) are those of surfaces.

    With the mean over the samples of a cell, the next surface y of each, and what of its light arrives,

        E_b = E_0 + mean(pi emission + arrival reflectance E_(b-1)(cell of y)),    E_0 directly from lights

    This is E = integral of L cos(theta) over the hemisphere, estimated by one direction of density cos(theta) / pi, so
    by pi L. A matte surface y with the reflectance r has L = r E(y) / pi, of which the share `arrival` comes through.
    The iteration is the Neumann series of the rendering equation over the cells, one reflection a step.

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
    reflected_share = (paths.arrival * paths.reflectance)[2:][is_sample]
    gains = np.where((after >= 0)[:, None], reflected_share, 0.0)
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


def from_emitter(
    scene: Any, ds: Any, si: Any, light: Any, active: Any, openings: CutOuts | None
) -> Any:
    """The part of `light` from the point `ds` of an emitter that reaches the surface at `si`.

    The shadow ray starts a little off the surface, on its lit side, and must meet the side of the emitter that shines.
    Mitsuba compares that side with the direction between the two points, which rounding decides where both are on one
    sphere: a ball that shines outward would light its own inside.
    """
    ray = si.spawn_ray_to(ds.p)
    meets_lit_side = ds.delta | (dr.dot(ray.d, ds.n) < 0)
    return arriving(scene, si, ds.p, light, active & meets_lit_side, openings)


def mis(density: Any, density_of_other: Any) -> Any:
    """The weight of a sample that one of two techniques drew, from its densities p and q in both: the power heuristic.

    w = p^2 / (p^2 + q^2); the weights of both techniques add up to 1. A light seen from its edge has an infinite
    density and sends nothing. Source: Veach 1997, section 9.2.3.
    """
    square = density * density
    weight = square / (square + density_of_other * density_of_other)
    return dr.select(dr.isfinite(weight), weight, 0.0)


def _vectors(values: NDArray[np.float32]) -> Any:
    """Vectors (..., 3) as one Dr.Jit array."""
    return mi.Vector3f(values.reshape(-1, 3).T)


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
