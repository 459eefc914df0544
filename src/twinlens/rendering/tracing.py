"""Traces rays from surface to surface: the one tracer of ground truth.

`trace_surfaces` gives the first surface that each ray hits, the first rough one behind glass and mirrors, or all of
them on its way. Mitsuba finds them in float32, and `surfaces` intersects the same primitives in float64. Guides of the
denoiser trace many samples in one kernel of Dr.Jit; the rule by which rays pass surfaces, `passage`, is the same.

Where a surface is cut out (`rendering.cut_outs`), there is none: `intersect` continues the ray behind it.

A ray is an origin and a unit direction in world coordinates, and its parameter t is a distance in metres. Depth along
an optical axis is t times the cosine to that axis.
"""

import enum
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinlens.geometry import Float
from twinlens.rendering.arrays import aligned
from twinlens.rendering.backends import mitsuba
from twinlens.rendering.build import BuiltScene
from twinlens.rendering.cut_outs import CUT, CutOuts, cut_outs
from twinlens.rendering.frames import SceneFrame
from twinlens.rendering.surfaces import (
    MAX_CORRECTION,
    Exact,
    Quadric,
    Triangles,
    refine,
    surfaces,
)

MAX_SPECULAR = 8
"""Mirrors, glass and openings that a ray passes before it stops."""

MAX_CUT_OUTS = 4096
"""Cut-outs that a ray passes. It ends at the next one, whatever its opacity, so that no ray goes on forever."""

_UNKNOWN_KIND = 0  # in MATERIAL_KINDS
_SPECULAR_KINDS = (3, 4)  # mirror and transmissive
_SAME_POINT = 1e-5  # relative tolerance for two rays that end at the same point
_SAME_DIRECTION = 1e-3  # between directions in float32 and float64
_CLEARANCE = (
    2.0**-16
)  # of a ray's start from the surface that it leaves, relative to coordinates
_LEAST_COSINE = 0.05
_CUT_OUT_CLEARANCE = 2.0**-18
"""Distance from a cut-out at which the ray goes on, relative to coordinates. A ray that meets it again passes again."""
_BUNDLE = 1 << 22  # rays traced at once; bounds the memory


class Stop(enum.Enum):
    """Where `trace_surfaces` stops."""

    FIRST = enum.auto()
    ROUGH = enum.auto()
    ALL = enum.auto()


@dataclass(frozen=True, eq=False)
class Rays:
    """N rays: origins (N, 3) and unit directions (N, 3), float64, in world coordinates."""

    origin: Float
    direction: Float

    def __len__(self) -> int:
        return len(self.direction)

    def __getitem__(self, chosen: Any) -> "Rays":
        return Rays(self.origin[chosen], self.direction[chosen])

    def at(self, t: Any) -> Float:
        """The points (N, 3) at the distances t (N,)."""
        return np.asarray(self.origin + np.asarray(t)[..., None] * self.direction)

    def in_frame(self, frame: SceneFrame) -> "Rays":
        """Rays of the world in a frame, whose axes are parallel to the world's."""
        return Rays(frame.points(self.origin), self.direction)

    @classmethod
    def from_point(cls, origin: Float, directions: Float) -> "Rays":
        """Rays of one origin (3,) in directions (N, 3) of any lengths."""
        unit = directions / lengths(directions)[:, None]
        return cls(np.broadcast_to(origin, unit.shape), unit)


class Intersections(NamedTuple):
    """What N rays hit first, in float32.

    body : int32 (N,), row of the scene's body table, -1 where nothing was hit.
    t : float64 (N,), +inf where nothing was hit.
    prim : uint32 (N,), the triangle of a mesh.
    start : float64 (N,), the distance behind the last cut-out that the ray passed; 0 where it passed none.
    share : float64 (N,), the share of the light that passes the cut-outs: 1 unless they are partly opaque.
    """

    body: NDArray[np.int32]
    t: Float
    prim: NDArray[np.uint32]
    start: Float
    share: Float

    @classmethod
    def nothing(cls, count: int) -> "Intersections":
        """Rays that hit nothing."""
        return cls(
            np.full(count, -1, np.int32),
            np.full(count, np.inf),
            np.zeros(count, np.uint32),
            np.zeros(count),
            np.ones(count),
        )

    def of(self, chosen: Any) -> "Intersections":
        """Those of some of the rays."""
        return Intersections(*(values[chosen] for values in self))


@dataclass(frozen=True, eq=False)
class Hits:
    """Where N rays hit surfaces, in float64.

    body, prim : as `Intersections`.
    distance : (N,), metres along the way of the ray from its origin; +inf where nothing was hit.
    position : (N, 3); +inf where nothing was hit.
    direction : (N, 3), the unit direction in which the ray arrives; 0 where no ray is left.
    normal : (N, 3), unit, on the side where the ray arrives; 0 where nothing was hit.
    shading_normal : (N, 3), unit, on the side of `normal`.
    share : (N,), the share of the light that takes this way at the surfaces before; 0 where no ray is left.
    """

    body: NDArray[np.int32]
    prim: NDArray[np.uint32]
    distance: Float
    position: Float
    direction: Float
    normal: Float
    shading_normal: Float
    share: Float

    @property
    def is_hit(self) -> NDArray[np.bool_]:
        """Whether each ray hit a surface, bool (N,)."""
        return np.asarray(self.body >= 0)

    def of(self, chosen: Any) -> "Hits":
        """Those of some of the rays."""
        return Hits(*(values[chosen] for values in vars(self).values()))

    def replaced(self, rows: Any, hits: "Hits") -> "Hits":
        """A copy with the hits of some of the rays replaced."""
        whole = {name: values.copy() for name, values in vars(self).items()}
        for name, values in vars(hits).items():
            whole[name][rows] = values
        return Hits(**whole)

    def in_world(self, frame: SceneFrame) -> "Hits":
        """Hits in a frame as they are in the world."""
        return replace(
            self,
            distance=self.distance / frame.scale,
            position=frame.points_in_world(self.position),
        )

    @classmethod
    def nothing(cls, count: int) -> "Hits":
        """The hits of rays that have ended before."""
        zeros = np.zeros((count, 3))
        return cls(
            body=np.full(count, -1, np.int32),
            prim=np.zeros(count, np.uint32),
            distance=np.full(count, np.inf),
            position=np.full((count, 3), np.inf),
            direction=zeros,
            normal=zeros,
            shading_normal=zeros,
            share=np.zeros(count),
        )


def trace_surfaces(
    built: BuiltScene, rays: Rays, stop: Stop = Stop.FIRST
) -> list[Hits]:
    """The surfaces that rays hit, in layers: row n of every layer is of ray n.

    FIRST gives one layer, the first surfaces. ROUGH gives one layer, the first surfaces that are not mirrors, smooth
    glass or openings. ALL gives the first, second, ... surfaces up to that one, in as many layers as the longest way
    has; rays that ended before hit nothing. Rays pass at most `MAX_SPECULAR` surfaces. Where a surface both reflects
    and transmits, the ray is transmitted. Rays and hits are in the world.
    """
    layers = _layers(built, rays.in_frame(built.frame), stop)
    return [layer.in_world(built.frame) for layer in layers]


def _layers(built: BuiltScene, rays: Rays, stop: Stop) -> list[Hits]:
    """`trace_surfaces` in the frame of the built scene, as all that follows here."""
    first, way = _hits(built, _Way.start(rays))
    layers = [first]
    if stop is Stop.FIRST:
        return layers
    last = first
    while len(layers) <= MAX_SPECULAR:
        way = _onward(built, way, layers[-1])
        if not len(way.rows):
            break
        hits, way = _hits(built, way)
        layers.append(Hits.nothing(len(rays)).replaced(way.rows, hits))
        last = last.replaced(way.rows, hits)
    return [last] if stop is Stop.ROUGH else layers


class _Way(NamedTuple):
    """The M rays of N that have not ended, from the surfaces that they passed last.

    rows : (M,), their numbers among the N.
    rays : from the exact points that they passed.
    clearance : (M,), distance from these points to those where Mitsuba's rays start.
    distance, share : (M,), as in `Hits`, up to these points.
    """

    rows: NDArray[np.int64]
    rays: Rays
    clearance: Float
    distance: Float
    share: Float

    @classmethod
    def start(cls, rays: Rays) -> "_Way":
        count = len(rays)
        return cls(
            np.arange(count), rays, np.zeros(count), np.zeros(count), np.ones(count)
        )

    def of(self, chosen: Any) -> "_Way":
        """Some of the rays."""
        return _Way(
            self.rows[chosen],
            self.rays[chosen],
            self.clearance[chosen],
            self.distance[chosen],
            self.share[chosen],
        )

    def mitsuba_rays(self) -> Rays:
        """The rays from where Mitsuba's start."""
        return Rays(self.rays.at(self.clearance), self.rays.direction)


def _hits(built: BuiltScene, way: _Way) -> tuple[Hits, _Way]:
    """What the rays of `way` hit next, (M,) rows, and the way from the last cut-out before it."""
    rays = way.rays
    intersections = _intersections(built, way.mitsuba_rays())
    intersections = intersections._replace(t=way.clearance + intersections.t)
    way = way._replace(
        clearance=way.clearance + intersections.start,
        share=way.share * intersections.share,
    )
    exact = refined(built, rays, intersections, way.mitsuba_rays())
    hit = intersections.body >= 0
    position = np.full_like(rays.direction, np.inf)
    position[hit] = rays[hit].at(exact.t[hit])
    normal = _facing(exact.normal, -rays.direction)
    hits = Hits(
        body=intersections.body,
        prim=intersections.prim,
        distance=way.distance + exact.t,
        position=position,
        direction=rays.direction,
        normal=normal,
        shading_normal=_facing(exact.shading_normal, normal),
        share=way.share,
    )
    return hits, way


def _onward(built: BuiltScene, way: _Way, layer: Hits) -> _Way:
    """The rays that pass the surfaces of `layer`, which those of `way` hit."""
    specular = may_pass(built)[layer.body[way.rows]]
    way = way.of(specular)
    if not len(way.rows):
        return way
    passages = _passages(built, way.mitsuba_rays())
    way = way.of(passages.passes)
    passages = passages.of(passages.passes)
    hits = layer.of(way.rows)
    direction = _exact_direction(hits, passages)
    return _Way(
        way.rows,
        Rays(hits.position, direction),
        _clearance(hits, direction),
        hits.distance,
        way.share * passages.share,
    )


def _clearance(hits: Hits, direction: Float) -> Float:
    """The distance along rays that leave surfaces at which their rounded coordinates are off the surface.

    A ray at a small angle to the surface has to go farther.
    """
    size = np.abs(hits.position).max(axis=1, initial=0.0)
    cosine = np.abs(np.einsum("nc,nc->n", hits.normal, direction))
    largest = np.maximum(size, hits.distance)
    return np.asarray(_CLEARANCE * largest / np.maximum(cosine, _LEAST_COSINE))


class _Passages(NamedTuple):
    """How M rays go on at a surface, from Mitsuba in float32.

    passes : whether they do.
    direction : (M, 3), unit.
    share : of the light that takes this way.
    is_null : whether the direction is that of arrival.
    is_transmitted : whether the ray is refracted, by the relative index `eta`; the others are reflected.
    """

    passes: NDArray[np.bool_]
    direction: Float
    share: Float
    is_null: NDArray[np.bool_]
    is_transmitted: NDArray[np.bool_]
    eta: Float

    def of(self, chosen: Any) -> "_Passages":
        return _Passages(*(values[chosen] for values in self))


def _passages(built: BuiltScene, rays: Rays) -> _Passages:
    mi = mitsuba()
    si = built.mi_scene.ray_intersect(_mitsuba_ray(rays))
    passes, _, sample, _ = passage(si.bsdf(), si, si.is_valid())
    direction = si.to_world(sample.wo)
    is_transmitted = mi.has_flag(sample.sampled_type, mi.BSDFFlags.DeltaTransmission)
    count = len(rays)
    return _Passages(
        np.asarray(passes)[:count],
        np.asarray(direction, dtype=np.float64).T[:count],
        np.asarray(sample.pdf, dtype=np.float64)[:count],
        np.asarray(is_null(sample))[:count],
        np.asarray(is_transmitted)[:count],
        np.asarray(sample.eta, dtype=np.float64)[:count],
    )


def _exact_direction(hits: Hits, passages: _Passages) -> Float:
    """The unit directions (M, 3) of rays behind surfaces, by the laws of reflection and refraction in float64.

    With the normal n towards the ray's origin, d n = -cos, and the relative index eta of the two sides:

        reflected d + 2 cos n,   refracted d / eta + (cos / eta - sqrt(1 - (1 - cos^2) / eta^2)) n   (Snell)

    Mitsuba's direction stays where it differs by more than rounding: bumps of a surface are not in its normals.
    """
    arrival = hits.direction
    normal = _facing(hits.shading_normal, -arrival)
    cosine = -np.einsum("nc,nc->n", arrival, normal)[:, None]
    eta = passages.eta[:, None]
    reflected = arrival + 2 * cosine * normal
    squared_cosine_behind = np.maximum(1 - (1 - cosine**2) / eta**2, 0.0)
    along_normal = cosine / eta - np.sqrt(squared_cosine_behind)
    refracted = arrival / eta + along_normal * normal
    exact = np.where(passages.is_transmitted[:, None], refracted, reflected)
    exact = np.where(passages.is_null[:, None], arrival, exact)
    rounded = passages.direction / lengths(passages.direction)[:, None]
    error = np.abs(exact - rounded).max(axis=1, keepdims=True)
    return np.where(error <= _SAME_DIRECTION, exact, rounded)


def lengths(vectors: Float) -> Float:
    """The lengths (N,) of vectors (N, 3)."""
    return np.asarray(np.sqrt(np.einsum("nc,nc->n", vectors, vectors)))


def _facing(vectors: Float, towards: Float) -> Float:
    """Vectors (N, 3), negated where they point away from `towards` (N, 3)."""
    away = np.einsum("nc,nc->n", vectors, towards) < 0
    return np.where(away[:, None], -vectors, vectors)


def may_pass(built: BuiltScene) -> NDArray[np.bool_]:
    """Whether rays may pass each body: mirrors, glass and openings. The last row, of no body, is False."""
    kinds = [body.material_kind for body in built.bodies]
    passes = np.isin([*kinds, -1], (_UNKNOWN_KIND, *_SPECULAR_KINDS))
    openings = cut_outs(built)
    if openings is not None:
        passes[:-1] |= [openings.has(body.shape) for body in built.bodies]
    return passes


def passage(bsdf: Any, si: Any, active: Any) -> tuple[Any, Any, Any, Any]:
    """How Dr.Jit's rays go on at surfaces: (whether they pass, whether these are specular, BSDF sample, its weight).

    Nothing is chosen at random: rays pass mirrors, smooth glass and openings, and are transmitted where possible.
    """
    mi = mitsuba()
    specular = active & is_specular(bsdf)
    sampled = specular | (active & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Null))
    # The largest number below 1 chooses transmission, unless nothing is transmitted.
    sample, weight = bsdf.sample(
        mi.BSDFContext(), si, 1 - 2.0**-24, mi.Point2f(0.5), sampled
    )
    return specular | (sampled & is_null(sample)), specular, sample, weight


def is_specular(bsdf: Any) -> Any:
    """Whether a surface is a mirror or smooth glass."""
    mi = mitsuba()
    is_delta = mi.has_flag(bsdf.flags(), mi.BSDFFlags.Delta)
    return is_delta & ~mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)


def is_null(sample: Any) -> Any:
    """Whether a path goes on through an opening."""
    mi = mitsuba()
    return mi.has_flag(sample.sampled_type, mi.BSDFFlags.Null)


def intersect(built: BuiltScene, rays: Rays, passing: bool = True) -> Intersections:
    """What rays of the world hit first, behind cut-outs unless `passing` is false, from Mitsuba in float32."""
    intersections = _intersections(built, rays.in_frame(built.frame), passing)
    return intersections._replace(
        t=intersections.t / built.frame.scale,
        start=intersections.start / built.frame.scale,
    )


def _intersections(
    built: BuiltScene, rays: Rays, passing: bool = True
) -> Intersections:
    """`intersect` in the frame of the built scene."""
    count = len(rays)
    intersections = Intersections.nothing(count)
    for start in range(0, count, _BUNDLE):
        bundle = slice(start, start + _BUNDLE)
        _intersect_bundle(built, rays[bundle], passing, intersections.of(bundle))
    return intersections


def _intersect_bundle(
    built: BuiltScene, rays: Rays, passing: bool, out: Intersections
) -> None:
    import drjit as dr

    mi, count = mitsuba(), len(rays)
    if not count:
        return
    openings = cut_outs(built) if passing else None
    if openings is None:
        nearest = built.mi_scene.ray_intersect_preliminary(_mitsuba_ray(rays))
        t, prim = nearest.t, nearest.prim_index
        shape, instance = nearest.shape, nearest.instance
    else:
        end = behind_cut_outs(built.mi_scene, _mitsuba_ray(rays), openings)
        t, prim, shape, instance = end.t, end.prim, end.shape, end.instance
        dr.eval(end.start, end.share)
        out.start[:] = np.asarray(end.start)[:count]
        out.share[:] = np.asarray(end.share)[:count]
    shape = dr.reinterpret_array(mi.UInt32, shape)
    instance = dr.reinterpret_array(mi.UInt32, instance)
    dr.eval(t, prim, shape, instance)
    # An instance is a body of its own; the shape that it places may be in many bodies.
    instance, shape = np.asarray(instance), np.asarray(shape)
    handle = np.where(instance > 0, instance, shape)[:count]
    hit = handle > 0
    out.body[:] = _row_of_handle(built)[handle]
    out.t[hit] = np.asarray(t)[:count][hit]
    out.prim[hit] = np.asarray(prim)[:count][hit]


@dataclass
class _Passing:
    """Rays on the way to the first surface that is not cut out: the state of Dr.Jit's loop.

    active : whether the ray goes on.
    count : cut-outs that it passed.
    start, share : as in `Intersections`.
    t, prim, shape, instance : what it hit last.
    """

    active: Any
    count: Any
    start: Any
    share: Any
    t: Any
    prim: Any
    shape: Any
    instance: Any


def behind_cut_outs(mi_scene: Any, ray: Any, openings: CutOuts) -> _Passing:
    """What rays hit behind the cut-outs that they pass, in one kernel."""
    import drjit as dr

    mi = mitsuba()
    begin = _Passing(
        active=mi.Bool(True),
        count=mi.UInt32(0),
        start=mi.Float(0.0),
        share=mi.Float(1.0),
        t=mi.Float(0.0),
        prim=mi.UInt32(0),
        shape=dr.zeros(mi.ShapePtr),
        instance=dr.zeros(mi.ShapePtr),
    )
    (end,) = dr.while_loop(
        (begin,),
        lambda passing: passing.active,
        lambda passing: (_past_cut_out(mi_scene, ray, openings, passing),),
    )
    return end


def _past_cut_out(
    mi_scene: Any, ray: Any, openings: CutOuts, passing: _Passing
) -> _Passing:
    """The rays after their next surface. They stay on their lines: each starts behind a cut-out, at ray.o + start d."""
    import drjit as dr

    mi, active = mitsuba(), passing.active
    onward = mi.Ray3f(ray(passing.start), ray.d)
    nearest = mi_scene.ray_intersect_preliminary(onward, active=active)
    hit = active & nearest.is_valid()
    flags = mi.RayFlags.Minimal | mi.RayFlags.UV
    si = nearest.compute_surface_interaction(onward, flags, hit)
    transmission = openings.transmission(si, hit)
    passes = (transmission > 1 - CUT) & (passing.count < MAX_CUT_OUTS)
    t = passing.start + nearest.t
    size = dr.maximum(dr.max(dr.abs(ray(t))), t)
    return _Passing(
        active=hit & passes,
        count=passing.count + 1,
        start=dr.select(hit & passes, t + _CUT_OUT_CLEARANCE * size, passing.start),
        share=dr.select(hit & passes, passing.share * transmission, passing.share),
        t=t,
        prim=nearest.prim_index,
        shape=nearest.shape,
        instance=nearest.instance,
    )


def _mitsuba_ray(rays: Rays) -> Any:
    """The rays in float32, padded by copies of the last one to a multiple of 64."""
    mi, count = mitsuba(), len(rays)
    padded = np.minimum(np.arange(-(-count // 64) * 64), count - 1)
    # Each coordinate has memory of its own, so that one kernel serves any number of rays.
    origin, direction = (
        [mi.Float(aligned(column[padded].astype(np.float32))) for column in values.T]
        for values in (rays.origin, rays.direction)
    )
    return mi.Ray3f(mi.Point3f(*origin), mi.Vector3f(*direction))


def _row_of_handle(built: BuiltScene) -> NDArray[np.int32]:
    """The row of the body table for each handle of Dr.Jit's registry; -1 for handle 0, no shape."""
    if "rows" not in built.cache:
        import drjit as dr

        mi = mitsuba()
        handles = []
        for body in built.bodies:
            pointer = mi.ShapePtr(body.hit_object)
            handle = np.asarray(dr.reinterpret_array(mi.UInt32, pointer))
            handles.append(int(handle[0]))
        rows = np.full(max(handles, default=0) + 1, -1, dtype=np.int32)
        rows[handles] = np.arange(len(handles))
        built.cache["rows"] = rows
    return built.cache["rows"]  # type: ignore[no-any-return]


def refined(
    built: BuiltScene,
    rays: Rays,
    intersections: Intersections,
    mitsuba_rays: Rays | None = None,
) -> Exact:
    """`intersections` along `rays`, in float64.

    Shapes without a closed form keep Mitsuba's t, and have its normals along `mitsuba_rays`, or 0 if these are None.
    """
    exact = Exact(
        intersections.t.copy(),
        np.zeros_like(rays.direction),
        np.zeros_like(rays.direction),
    )
    order = np.argsort(intersections.body, kind="stable")
    bounds = np.searchsorted(
        intersections.body[order], np.arange(len(built.bodies) + 1)
    )
    for row, surface in enumerate(surfaces(built)):
        chosen = order[bounds[row] : bounds[row + 1]]
        if not len(chosen):
            continue
        part, hits = rays[chosen], intersections.of(chosen)
        if surface is not None:
            on_surface = refine(surface, part.origin, part.direction, hits.prim, hits.t)
            for values, new_values in zip(exact, on_surface, strict=True):
                values[chosen] = new_values
        elif mitsuba_rays is not None:
            exact.normal[chosen], exact.shading_normal[chosen] = _mitsuba_normals(
                built, mitsuba_rays[chosen]
            )
    return exact


def _mitsuba_normals(built: BuiltScene, rays: Rays) -> tuple[Float, Float]:
    """(geometric, shading) normals (N, 3) of first hits, in float32."""
    si = built.mi_scene.ray_intersect(_mitsuba_ray(rays))
    normal = np.asarray(si.n, dtype=np.float64).T
    shading_normal = np.asarray(si.sh_frame.n, dtype=np.float64).T
    return normal[: len(rays)], shading_normal[: len(rays)]


def visible_from(
    built: BuiltScene,
    centre: Float,
    points: Float,
    body: NDArray[np.int32],
    prim: NDArray[np.uint32],
) -> NDArray[np.bool_]:
    """Whether each point is the first hit of the ray from `centre` to it: on the same plane, or at the same distance.

    Hits slightly in front of the point are refined: the float32 errors of grazing hits exceed the tolerance.
    """
    offset = built.frame.scale * (points - centre)
    rays = Rays.from_point(built.frame.points(centre), offset)
    distance = lengths(offset)
    intersections = _intersections(built, rays)
    is_mesh, is_flat = _planes(built)
    same_plane = is_flat[body] | (is_mesh[body] & (intersections.prim == prim))
    same_plane &= intersections.body == body
    nearest = (1 - _SAME_POINT) * distance
    clear: NDArray[np.bool_] = same_plane | (intersections.t >= nearest)
    is_close = intersections.t >= (1 - 2 * MAX_CORRECTION) * distance
    doubtful = np.flatnonzero(~clear & is_close)
    exact = refined(built, rays[doubtful], intersections.of(doubtful))
    clear[doubtful] = exact.t >= nearest[doubtful]
    return clear


def _planes(built: BuiltScene) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Whether each body is a mesh, and whether it is one plane; False in the last row, of no body."""
    shapes = [*surfaces(built), None]
    is_mesh = np.array([isinstance(surface, Triangles) for surface in shapes])
    is_flat = np.array(
        [isinstance(surface, Quadric) and surface.is_flat for surface in shapes]
    )
    return is_mesh, is_flat
