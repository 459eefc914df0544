"""Hits refined in float64 on the primitive that Mitsuba hit in float32, and visibility from other cameras.

Triangles are intersected by their planes. Spheres, cylinders, disks and rectangles are intersected in their own unit
space, where they are the same for every pose (t is invariant under affine maps). Other shapes keep Mitsuba's float32
hits. Surfaces are read back from Mitsuba once for each scene.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Rig
from twinlens.geometry import Float, inverse, rotate
from twinlens.rendering.backends import mitsuba
from twinlens.rendering.build import Body, BuiltScene
from twinlens.rendering.cast import Hits, cast, mitsuba_normals

MAX_CORRECTION = 1e-3  # relative; a larger correction of t is an error of a grazing hit, and Mitsuba's t is kept


@dataclass(frozen=True, eq=False)
class Triangles:
    """A mesh: vertices (V, 3), faces (F, 3), vertex normals (V, 3) or None, all in the space of `world_from_local`."""

    vertices: Float
    faces: NDArray[np.uint32]
    normals: Float | None
    world_from_local: Float


@dataclass(frozen=True, eq=False)
class Quadric:
    """A unit shape (see UNIT_SHAPES) placed by an affine `world_from_local`."""

    kind: str
    world_from_local: Float


@dataclass(frozen=True, eq=False)
class Exact:
    """Refined hits: t (N,), geometric and shading normals (N, 3), unit, in world coordinates."""

    t: Float
    normal: Float
    shading_normal: Float


def refine(surface: Triangles | Quadric, origin: Float, directions: Float, prim: NDArray[np.uint32], t: Float) -> Exact:
    """Hits of origin + t directions with `surface`, near the float32 parameters t (N,)."""
    local_from_world: Float = np.linalg.inv(surface.world_from_local).astype(np.float64)
    o = local_from_world[:3, :3] @ origin + local_from_world[:3, 3]
    d = directions @ local_from_world[:3, :3].T
    with np.errstate(divide="ignore", invalid="ignore"):
        exact = _triangles(surface, o, d, prim) if isinstance(surface, Triangles) else _unit(surface, o, d, t)
        good = np.abs(exact.t - t) <= MAX_CORRECTION * t
    return Exact(
        np.where(good, exact.t, t),
        _to_world(local_from_world, exact.normal),
        _to_world(local_from_world, exact.shading_normal),
    )


def _to_world(local_from_world: Float, normals: Float) -> Float:
    turned: Float = normals @ local_from_world[:3, :3]  # the inverse transpose of world_from_local
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    return turned


def _triangles(mesh: Triangles, o: Float, d: Float, prim: NDArray[np.uint32]) -> Exact:
    corners = mesh.vertices[mesh.faces[prim]]
    a, ab, ac = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(ab, ac)
    t = _dot(a - o, normal) / _dot(d, normal)
    if mesh.normals is None:
        return Exact(t, normal, normal)
    weights = _barycentric(o + t[:, None] * d - a, ab, ac, normal)
    shading = np.einsum("nk,nkc->nc", weights, mesh.normals[mesh.faces[prim]])
    return Exact(t, normal, shading)


def _barycentric(p: Float, ab: Float, ac: Float, normal: Float) -> Float:
    area = _dot(normal, normal)
    b = _dot(np.cross(p, ac), normal) / area
    c = _dot(np.cross(ab, p), normal) / area
    return np.stack([1 - b - c, b, c], axis=1)


def _unit(surface: Quadric, o: Float, d: Float, t: Float) -> Exact:
    roots, normal_at = UNIT_SHAPES[surface.kind]
    candidates = roots(o, d)
    nearest = np.argmin(np.abs(np.nan_to_num(candidates, nan=np.inf) - t), axis=0)
    exact = np.take_along_axis(candidates, nearest[None], axis=0)[0]
    normal = normal_at(o + exact[:, None] * d)
    return Exact(exact, normal, normal)


def _quadratic(a: Float, half_b: Float, c: Float) -> Float:
    """Both roots (2, N) of a t^2 + 2 half_b t + c = 0 without cancellation; NaN where there is none."""
    q = -(half_b + np.copysign(np.sqrt(half_b**2 - a * c), half_b))
    return np.stack([q / a, c / q])


def _sphere(o: Float, d: Float) -> Float:
    return _quadratic(_dot(d, d), _dot(d, o), np.broadcast_to(o @ o - 1, len(d)))


def _cylinder(o: Float, d: Float) -> Float:
    return _sphere(o[:2], d[:, :2])  # the circle in the plane across the axis


def _plane(o: Float, d: Float) -> Float:
    t: Float = -o[2] / d[:, 2]
    return t[None]


def _along_z(p: Float) -> Float:
    return np.broadcast_to(np.array([0.0, 0.0, 1.0]), p.shape)


UNIT_SHAPES: dict[str, tuple[Callable[[Float, Float], Float], Callable[[Float], Float]]] = {
    "sphere": (_sphere, lambda p: p),
    "cylinder": (_cylinder, lambda p: p * (1.0, 1.0, 0.0)),
    "disk": (_plane, _along_z),
    "rectangle": (_plane, _along_z),
}
FLAT_SHAPES = ("disk", "rectangle")


def _dot(a: Float, b: Float) -> Float:
    product: Float = (a * b).sum(axis=-1)
    return product


_SAME_POINT = 1e-5  # relative tolerance for two rays that end at the same point


def exact_hits(built: BuiltScene, origin: Float, directions: Float, hits: Hits, measure: bool = True) -> Exact:
    """Refined hits: t, geometric and shading normals.

    Shapes without a closed form keep Mitsuba's t; their normals are Mitsuba's with `measure`, else zero.
    """
    exact = Exact(hits.t.copy(), np.zeros_like(directions), np.zeros_like(directions))
    order = np.argsort(hits.body, kind="stable")
    bounds = np.searchsorted(hits.body[order], np.arange(len(built.bodies) + 1))
    for row, body in enumerate(built.bodies):
        chosen = order[bounds[row] : bounds[row + 1]]
        if not len(chosen):
            continue
        surface = _surface(built, row, body)
        if surface is None and not measure:
            continue
        if surface is None:
            exact.normal[chosen], exact.shading_normal[chosen] = mitsuba_normals(built, origin, directions[chosen])
            continue
        part = refine(surface, origin, directions[chosen], hits.prim[chosen], hits.t[chosen])
        exact.t[chosen], exact.normal[chosen], exact.shading_normal[chosen] = part.t, part.normal, part.shading_normal
    return exact


def _surface(built: BuiltScene, row: int, body: Body) -> Triangles | Quadric | None:
    """The body's surface in float64, cached with the scene. Instances share the vertices of their shape."""
    key = f"surface{row}"
    if key not in built.cache:
        shared = None if body.shape is None else _shape_surface(built, body.shape)
        if shared is not None and body.instance is not None:
            shared = replace(shared, world_from_local=_shape_to_world(body.instance) @ shared.world_from_local)
        built.cache[key] = shared
    surface: Triangles | Quadric | None = built.cache[key]
    return surface


def _shape_surface(built: BuiltScene, shape: Any) -> Triangles | Quadric | None:
    key = f"shape{id(shape)}"
    if key not in built.cache:
        built.cache[key] = _read_surface(shape)
    surface: Triangles | Quadric | None = built.cache[key]
    return surface


def _read_surface(shape: Any) -> Triangles | Quadric | None:
    mi = mitsuba()
    kinds = {
        mi.ShapeType.Sphere: "sphere",
        mi.ShapeType.Cylinder: "cylinder",
        mi.ShapeType.Disk: "disk",
        mi.ShapeType.Rectangle: "rectangle",
    }
    kind = kinds.get(mi.ShapeType(shape.shape_type()))
    if kind in UNIT_SHAPES:
        return Quadric(kind, _shape_to_world(shape))
    return _read_mesh(shape) if shape.is_mesh() else None


def _shape_to_world(shape: Any) -> Float:
    matrix = mitsuba().traverse(shape)["to_world"].matrix
    return np.asarray(matrix, dtype=np.float64).reshape(4, 4)


def _read_mesh(shape: Any) -> Triangles:
    buffers = mitsuba().traverse(shape)
    normals = np.asarray(buffers["vertex_normals"], dtype=np.float64).reshape(-1, 3)
    return Triangles(
        np.asarray(buffers["vertex_positions"], dtype=np.float64).reshape(-1, 3),
        np.asarray(buffers["faces"], dtype=np.uint32).reshape(-1, 3),
        normals if len(normals) and shape.has_vertex_normals() and not shape.has_face_normals() else None,
        np.eye(4),
    )


def infinity_visible_from(built: BuiltScene, rig: Rig, other: int, directions: Float) -> NDArray[np.bool_]:
    """Whether camera `other` sees the points at infinity along world directions (N, 3)."""
    pose = rig.world_from_cams[other]
    inside = rig.cameras[other].contains(rig.cameras[other].project(rotate(inverse(pose), directions)))
    seen: NDArray[np.bool_] = inside & (cast(built, pose[:3, 3], directions).body < 0)
    return seen


def visible_from(
    built: BuiltScene, centre: Float, points: Float, body: NDArray[np.int32], prim: NDArray[np.uint32]
) -> NDArray[np.bool_]:
    """Whether each point is the first hit of the ray from `centre` to it: on the same plane, or at the same distance.

    Hits slightly in front of the point are refined, because float32 errors of grazing hits exceed _SAME_POINT.
    """
    rays = points - centre
    hits = cast(built, centre, rays)
    surfaces = [_surface(built, row, thing) for row, thing in enumerate(built.bodies)]
    triangles = np.array([*(isinstance(surface, Triangles) for surface in surfaces), False])
    one_plane = np.array([*map(_is_plane, surfaces), False])
    same_plane = (hits.body == body) & (one_plane[body] | (triangles[body] & (hits.prim == prim)))
    clear: NDArray[np.bool_] = same_plane | (hits.t >= 1 - _SAME_POINT)
    doubtful = np.flatnonzero(~clear & (hits.t >= 1 - 2 * MAX_CORRECTION))
    near = Hits(hits.body[doubtful], hits.t[doubtful], hits.prim[doubtful])
    clear[doubtful] = exact_hits(built, centre, rays[doubtful], near, measure=False).t >= 1 - _SAME_POINT
    return clear


def _is_plane(surface: Triangles | Quadric | None) -> bool:
    """Whether the whole surface is one plane, which cannot occlude itself even at grazing angles."""
    return isinstance(surface, Quadric) and surface.kind in FLAT_SHAPES
