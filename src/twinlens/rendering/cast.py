"""First hits of many rays as numpy arrays: Mitsuba's in float32, refined in float64, and visibility from other points.

Directions are not normalised: with z = 1 in the camera frame, the ray parameter t is the depth. Triangles are
intersected by their planes. Spheres, cylinders, disks and rectangles are intersected in their own unit space, where
they are the same for every pose (t is invariant under affine maps).
"""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinlens.geometry import Float
from twinlens.rendering.backends import mitsuba
from twinlens.rendering.build import BuiltScene

_MAX_CORRECTION = 1e-3  # relative; a larger correction of t is an error of a grazing hit, and Mitsuba's t is kept
_ROUND_AXES = {"sphere": 3, "cylinder": 2}  # coordinates whose squares sum to 1
_SAME_POINT = 1e-5  # relative tolerance for two rays that end at the same point
_BUNDLE = 1 << 22  # rays traced at once; bounds the memory


@dataclass(frozen=True, eq=False)
class Triangles:
    """A mesh: vertices (V, 3), faces (F, 3), vertex normals (V, 3) or None, all in the space of `world_from_local`."""

    vertices: Float
    faces: NDArray[np.uint32]
    normals: Float | None
    world_from_local: Float


@dataclass(frozen=True, eq=False)
class Quadric:
    """A unit sphere, cylinder, disk or rectangle, placed by an affine `world_from_local`."""

    kind: str
    world_from_local: Float

    @property
    def is_flat(self) -> bool:
        """Whether the surface is one plane, which cannot occlude itself even at grazing angles."""
        return self.kind not in _ROUND_AXES


Surface = Triangles | Quadric


class Exact(NamedTuple):
    """Refined hits: t (N,), geometric and shading normals (N, 3), unit, in world coordinates."""

    t: Float
    normal: Float
    shading_normal: Float


def refine(
    surface: Surface,
    origin: Float,
    directions: Float,
    prim: NDArray[np.uint32],
    t: Float,
) -> Exact:
    """Hits of origin + t directions with `surface`, near the float32 parameters t (N,)."""
    local_from_world: Float = np.linalg.inv(surface.world_from_local).astype(np.float64)
    o = local_from_world[:3, :3] @ origin + local_from_world[:3, 3]
    d = directions @ local_from_world[:3, :3].T
    with np.errstate(divide="ignore", invalid="ignore"):
        exact = (
            _on_triangles(surface, o, d, prim)
            if isinstance(surface, Triangles)
            else _on_unit(surface, o, d, t)
        )
        good = np.abs(exact.t - t) <= _MAX_CORRECTION * t
    normals = []
    for local in (exact.normal, exact.shading_normal):
        turned = (
            local @ local_from_world[:3, :3]
        )  # the inverse transpose of world_from_local
        turned /= np.linalg.norm(turned, axis=1, keepdims=True)
        normals.append(turned)
    return Exact(np.where(good, exact.t, t), *normals)


def _on_triangles(
    mesh: Triangles, o: Float, d: Float, prim: NDArray[np.uint32]
) -> Exact:
    corners = mesh.vertices[mesh.faces[prim]]
    a, ab, ac = (
        corners[:, 0],
        corners[:, 1] - corners[:, 0],
        corners[:, 2] - corners[:, 0],
    )
    normal = np.cross(ab, ac)
    t = _dot(a - o, normal) / _dot(d, normal)
    if mesh.normals is None:
        return Exact(t, normal, normal)
    p, area = o + t[:, None] * d - a, _dot(normal, normal)
    b = _dot(np.cross(p, ac), normal) / area
    c = _dot(np.cross(ab, p), normal) / area
    weights = np.stack([1 - b - c, b, c], axis=1)
    return Exact(
        t, normal, np.einsum("nk,nkc->nc", weights, mesh.normals[mesh.faces[prim]])
    )


def _on_unit(surface: Quadric, o: Float, d: Float, t: Float) -> Exact:
    if surface.is_flat:
        normal = np.broadcast_to(np.array([0.0, 0.0, 1.0]), d.shape)
        return Exact(-o[2] / d[:, 2], normal, normal)
    axes = _ROUND_AXES[surface.kind]
    o_round, d_round = o[:axes], d[:, :axes]
    roots = _quadratic(
        _dot(d_round, d_round),
        _dot(d_round, o_round),
        np.broadcast_to(o_round @ o_round - 1, len(d)),
    )
    nearest = np.argmin(np.abs(np.nan_to_num(roots, nan=np.inf) - t), axis=0)
    exact = np.take_along_axis(roots, nearest[None], axis=0)[0]
    normal = (o + exact[:, None] * d) * (np.arange(3) < axes)
    return Exact(exact, normal, normal)


def _quadratic(a: Float, half_b: Float, c: Float) -> Float:
    """Both roots (2, N) of a t^2 + 2 half_b t + c = 0 without cancellation; NaN where there is none."""
    q = -(half_b + np.copysign(np.sqrt(half_b**2 - a * c), half_b))
    return np.stack([q / a, c / q])


def _dot(a: Float, b: Float) -> Float:
    return np.asarray((a * b).sum(axis=-1))


def surfaces(built: BuiltScene) -> list[Surface | None]:
    """The surface of each body, or None for a shape without a closed form; read from Mitsuba once for each scene."""
    if "surfaces" not in built.cache:
        read: dict[int, Surface | None] = {id(None): None}
        placed = []
        for body in built.bodies:
            if id(body.shape) not in read:
                read[id(body.shape)] = _read_surface(body.shape)
            surface = read[id(body.shape)]
            if (
                surface is not None and body.instance is not None
            ):  # instances share the vertices of their shape
                surface = replace(
                    surface,
                    world_from_local=_pose(body.instance) @ surface.world_from_local,
                )
            placed.append(surface)
        built.cache["surfaces"] = placed
    return built.cache["surfaces"]  # type: ignore[no-any-return]


def _read_surface(shape: Any) -> Surface | None:
    mi = mitsuba()
    kind = mi.ShapeType(shape.shape_type()).name.lower()
    if kind in ("sphere", "cylinder", "disk", "rectangle"):
        return Quadric(kind, _pose(shape))
    if not shape.is_mesh():
        return None
    buffers = mi.traverse(shape)
    normals = np.asarray(buffers["vertex_normals"], dtype=np.float64).reshape(-1, 3)
    return Triangles(
        np.asarray(buffers["vertex_positions"], dtype=np.float64).reshape(-1, 3),
        np.asarray(buffers["faces"], dtype=np.uint32).reshape(-1, 3),
        normals
        if len(normals) and shape.has_vertex_normals() and not shape.has_face_normals()
        else None,
        np.eye(4),
    )


def _pose(shape: Any) -> Float:
    matrix = mitsuba().traverse(shape)["to_world"].matrix
    return np.asarray(matrix, dtype=np.float64).reshape(4, 4)


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
    hits = Hits(
        np.full(count, -1, np.int32), np.full(count, np.inf), np.zeros(count, np.uint32)
    )
    lengths = np.sqrt(np.einsum("nc,nc->n", directions, directions))
    for start in range(0, count, _BUNDLE):
        part = slice(start, start + _BUNDLE)
        unit = (directions[part] / lengths[part, None]).astype(np.float32)
        _trace_bundle(
            built, origin, unit, Hits(hits.body[part], hits.t[part], hits.prim[part])
        )
    return Hits(hits.body, hits.t / lengths, hits.prim)


def _trace_bundle(
    built: BuiltScene, origin: Float, unit: NDArray[np.float32], out: Hits
) -> None:
    import drjit as dr

    mi, count = mitsuba(), len(unit)
    if not count:
        return
    step = 1 << max(
        count.bit_length() - 3, 6
    )  # Dr.Jit compiles a kernel in 15 ms for each number of rays: use few
    padded = np.empty((3, -(-count // step) * step), dtype=np.float32)
    padded[:, :count], padded[:, count:] = unit.T, unit[-1:].T
    ray = mi.Ray3f(mi.Point3f(origin), mi.Vector3f(padded))
    pi = built.mi_scene.ray_intersect_preliminary(ray)
    shape, instance = (
        dr.reinterpret_array(mi.UInt32, pointer) for pointer in (pi.shape, pi.instance)
    )
    dr.eval(pi.t, pi.prim_index, shape, instance)
    instance, shape, t, prim = (
        np.asarray(each)[:count] for each in (instance, shape, pi.t, pi.prim_index)
    )
    keys = np.where(instance > 0, instance, shape)  # prefer the instance
    out.body[:] = _row_of_handle(built)[keys]
    hit = keys > 0
    out.t[hit], out.prim[hit] = t[hit], prim[hit]


def _row_of_handle(built: BuiltScene) -> NDArray[np.int32]:
    """The row of the body table for each of Dr.Jit's registry handles; -1 for handle 0, no shape."""
    if "rows" not in built.cache:
        import drjit as dr

        mi = mitsuba()
        pointers = [mi.ShapePtr(body.hit_object) for body in built.bodies]
        handles = [
            int(np.asarray(dr.reinterpret_array(mi.UInt32, pointer))[0])
            for pointer in pointers
        ]
        rows = np.full(max(handles, default=0) + 1, -1, dtype=np.int32)
        rows[handles] = np.arange(len(handles))
        built.cache["rows"] = rows
    return built.cache["rows"]  # type: ignore[no-any-return]


def exact_hits(
    built: BuiltScene,
    origin: Float,
    directions: Float,
    hits: Hits,
    measure: bool = True,
) -> Exact:
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
            part = refine(
                surface, origin, directions[chosen], hits.prim[chosen], hits.t[chosen]
            )
            for whole, values in zip(exact, part, strict=True):
                whole[chosen] = values
        elif measure:
            exact.normal[chosen], exact.shading_normal[chosen] = _mitsuba_normals(
                built, origin, directions[chosen]
            )
    return exact


def _mitsuba_normals(
    built: BuiltScene, origin: Float, directions: Float
) -> tuple[Float, Float]:
    """(geometric, shading) normals (N, 3) in float32."""
    mi = mitsuba()
    towards = mi.Vector3f(np.ascontiguousarray(directions.T, dtype=np.float32))
    si = built.mi_scene.ray_intersect(mi.Ray3f(mi.Point3f(origin), towards))
    normal = np.asarray(si.n, dtype=np.float64).T
    shading_normal = np.asarray(si.sh_frame.n, dtype=np.float64).T
    return normal, shading_normal


def visible_from(
    built: BuiltScene,
    centre: Float,
    points: Float,
    body: NDArray[np.int32],
    prim: NDArray[np.uint32],
) -> NDArray[np.bool_]:
    """Whether each point is the first hit of the ray from `centre` to it: on the same plane, or at the same distance.

    Hits slightly in front of the point are refined, because float32 errors of grazing hits exceed _SAME_POINT.
    """
    rays = points - centre
    hits = cast(built, centre, rays)
    triangles = np.array(
        [*(isinstance(surface, Triangles) for surface in surfaces(built)), False]
    )
    flat = np.array(
        [
            *(
                isinstance(surface, Quadric) and surface.is_flat
                for surface in surfaces(built)
            ),
            False,
        ]
    )
    same_plane = (hits.body == body) & (
        flat[body] | (triangles[body] & (hits.prim == prim))
    )
    clear: NDArray[np.bool_] = same_plane | (hits.t >= 1 - _SAME_POINT)
    doubtful = np.flatnonzero(~clear & (hits.t >= 1 - 2 * _MAX_CORRECTION))
    near = Hits(hits.body[doubtful], hits.t[doubtful], hits.prim[doubtful])
    clear[doubtful] = (
        exact_hits(built, centre, rays[doubtful], near, measure=False).t
        >= 1 - _SAME_POINT
    )
    return clear
