"""First hits of many rays as numpy arrays: Mitsuba's in float32, refined in float64, and visibility from other points.

Directions are not normalised: with z = 1 in the camera frame, the ray parameter t is the depth.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twinlens.geometry import Float
from twinlens.rendering.backends import backend, mitsuba
from twinlens.rendering.build import BuiltScene
from twinlens.rendering.surfaces import MAX_CORRECTION, Exact, Quadric, Triangles, refine, surfaces

_SAME_POINT = 1e-5  # relative tolerance for two rays that end at the same point
_BUNDLE = 1 << 22  # rays traced at once; bounds the memory


@dataclass(frozen=True, eq=False)
class Hits:
    """First hits of N rays.

    body : int32 (N,), row of the scene's body table, -1 where nothing was hit.
    t : float64 (N,), the ray parameter, +inf where nothing was hit.
    prim : uint32 (N,), the triangle of a mesh.
    """

    body: NDArray[np.int32]
    t: Float
    prim: NDArray[np.uint32]


def cast(built: BuiltScene, origin: Float, directions: Float) -> Hits:
    """First hits along origin + t directions; origin (3,), directions (N, 3), world coordinates."""
    count = len(directions)
    hits = Hits(np.full(count, -1, np.int32), np.full(count, np.inf), np.zeros(count, np.uint32))
    trace = _trace_bundle if backend().is_jit else _trace_singly
    lengths = np.sqrt(np.einsum("nc,nc->n", directions, directions))
    for start in range(0, count, _BUNDLE):
        part = slice(start, start + _BUNDLE)
        unit = (directions[part] / lengths[part, None]).astype(np.float32)
        trace(built, origin, unit, Hits(hits.body[part], hits.t[part], hits.prim[part]))
    return Hits(hits.body, hits.t / lengths, hits.prim)


def _trace_bundle(built: BuiltScene, origin: Float, unit: NDArray[np.float32], out: Hits) -> None:
    import drjit as dr

    mi = mitsuba()
    ray = mi.Ray3f(mi.Point3f(origin), mi.Vector3f(np.ascontiguousarray(unit.T)))
    pi = built.mi_scene.ray_intersect_preliminary(ray)
    shape, instance = (dr.reinterpret_array(mi.UInt32, pointer) for pointer in (pi.shape, pi.instance))
    dr.eval(pi.t, pi.prim_index, shape, instance)
    keys = np.where(np.asarray(instance) > 0, np.asarray(instance), np.asarray(shape))  # prefer the instance
    out.body[:] = _row_of_handle(built)[keys]
    hit = keys > 0
    out.t[hit] = np.asarray(pi.t)[hit]
    out.prim[hit] = np.asarray(pi.prim_index)[hit]


def _row_of_handle(built: BuiltScene) -> NDArray[np.int32]:
    """The row of the body table for each of Dr.Jit's registry handles; -1 for handle 0, no shape."""
    if "rows" not in built.cache:
        import drjit as dr

        mi = mitsuba()
        pointers = [mi.ShapePtr(body.hit_object) for body in built.bodies]
        handles = [int(np.asarray(dr.reinterpret_array(mi.UInt32, pointer))[0]) for pointer in pointers]
        rows = np.full(max(handles, default=0) + 1, -1, dtype=np.int32)
        rows[handles] = np.arange(len(handles))
        built.cache["rows"] = rows
    table: NDArray[np.int32] = built.cache["rows"]
    return table


def _trace_singly(built: BuiltScene, origin: Float, unit: NDArray[np.float32], out: Hits) -> None:
    mi = mitsuba()
    rows = {body.hit_object: row for row, body in enumerate(built.bodies)}
    intersect, ray_type, vector = built.mi_scene.ray_intersect_preliminary, mi.Ray3f, mi.Vector3f
    start = mi.Point3f(origin)
    for i, (x, y, z) in enumerate(unit.tolist()):
        pi = intersect(ray_type(start, vector(x, y, z)))
        if pi.t != np.inf:
            out.body[i] = rows.get(pi.instance or pi.shape, -1)
            out.t[i] = pi.t
            out.prim[i] = pi.prim_index


def exact_hits(built: BuiltScene, origin: Float, directions: Float, hits: Hits, measure: bool = True) -> Exact:
    """Refined hits: t, geometric and shading normals.

    Shapes without a closed form keep Mitsuba's t; their normals are Mitsuba's with `measure`, else zero.
    """
    exact = Exact(hits.t.copy(), np.zeros_like(directions), np.zeros_like(directions))
    order = np.argsort(hits.body, kind="stable")
    bounds = np.searchsorted(hits.body[order], np.arange(len(built.bodies) + 1))
    for row, surface in enumerate(surfaces(built)):
        chosen = order[bounds[row] : bounds[row + 1]]
        if not len(chosen):
            continue
        if surface is not None:
            part = refine(surface, origin, directions[chosen], hits.prim[chosen], hits.t[chosen])
            for whole, values in zip(exact, part, strict=True):
                whole[chosen] = values
        elif measure:
            exact.normal[chosen], exact.shading_normal[chosen] = _mitsuba_normals(built, origin, directions[chosen])
    return exact


def _mitsuba_normals(built: BuiltScene, origin: Float, directions: Float) -> tuple[Float, Float]:
    """(geometric, shading) normals (N, 3) in float32."""
    mi = mitsuba()
    if backend().is_jit:
        towards = mi.Vector3f(np.ascontiguousarray(directions.T, dtype=np.float32))
        si = built.mi_scene.ray_intersect(mi.Ray3f(mi.Point3f(origin), towards))
        return np.asarray(si.n, dtype=np.float64).T, np.asarray(si.sh_frame.n, dtype=np.float64).T
    rays = [mi.Ray3f(mi.Point3f(origin), mi.Vector3f(*direction)) for direction in directions]
    found = [built.mi_scene.ray_intersect(ray) for ray in rays]
    return np.array([si.n for si in found], np.float64), np.array([si.sh_frame.n for si in found], np.float64)


def visible_from(
    built: BuiltScene, centre: Float, points: Float, body: NDArray[np.int32], prim: NDArray[np.uint32]
) -> NDArray[np.bool_]:
    """Whether each point is the first hit of the ray from `centre` to it: on the same plane, or at the same distance.

    Hits slightly in front of the point are refined, because float32 errors of grazing hits exceed _SAME_POINT.
    """
    rays = points - centre
    hits = cast(built, centre, rays)
    triangles = np.array([*(isinstance(surface, Triangles) for surface in surfaces(built)), False])
    flat = np.array([*(isinstance(surface, Quadric) and surface.is_flat for surface in surfaces(built)), False])
    same_plane = (hits.body == body) & (flat[body] | (triangles[body] & (hits.prim == prim)))
    clear: NDArray[np.bool_] = same_plane | (hits.t >= 1 - _SAME_POINT)
    doubtful = np.flatnonzero(~clear & (hits.t >= 1 - 2 * MAX_CORRECTION))
    near = Hits(hits.body[doubtful], hits.t[doubtful], hits.prim[doubtful])
    clear[doubtful] = exact_hits(built, centre, rays[doubtful], near, measure=False).t >= 1 - _SAME_POINT
    return clear
