"""Surfaces in float64, on which the hits that Mitsuba found in float32 are refined.

Triangles are intersected by their planes. Spheres, cylinders, disks and rectangles are intersected in their own unit
space, where they are the same for every pose (t is invariant under affine maps).
"""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinlens.geometry import Float
from twinlens.rendering.backends import mitsuba
from twinlens.rendering.build import BuiltScene

MAX_CORRECTION = 1e-3  # relative; a larger correction of t is an error of a grazing hit, and Mitsuba's t is kept
_ROUND_AXES = {"sphere": 3, "cylinder": 2}  # coordinates whose squares sum to 1


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


def refine(surface: Surface, origin: Float, directions: Float, prim: NDArray[np.uint32], t: Float) -> Exact:
    """Hits of origin + t directions with `surface`, near the float32 parameters t (N,)."""
    local_from_world: Float = np.linalg.inv(surface.world_from_local).astype(np.float64)
    o = local_from_world[:3, :3] @ origin + local_from_world[:3, 3]
    d = directions @ local_from_world[:3, :3].T
    with np.errstate(divide="ignore", invalid="ignore"):
        exact = _on_triangles(surface, o, d, prim) if isinstance(surface, Triangles) else _on_unit(surface, o, d, t)
        good = np.abs(exact.t - t) <= MAX_CORRECTION * t
    normals = []
    for local in (exact.normal, exact.shading_normal):
        turned = local @ local_from_world[:3, :3]  # the inverse transpose of world_from_local
        turned /= np.linalg.norm(turned, axis=1, keepdims=True)
        normals.append(turned)
    return Exact(np.where(good, exact.t, t), *normals)


def _on_triangles(mesh: Triangles, o: Float, d: Float, prim: NDArray[np.uint32]) -> Exact:
    corners = mesh.vertices[mesh.faces[prim]]
    a, ab, ac = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(ab, ac)
    t = _dot(a - o, normal) / _dot(d, normal)
    if mesh.normals is None:
        return Exact(t, normal, normal)
    p, area = o + t[:, None] * d - a, _dot(normal, normal)
    b = _dot(np.cross(p, ac), normal) / area
    c = _dot(np.cross(ab, p), normal) / area
    weights = np.stack([1 - b - c, b, c], axis=1)
    return Exact(t, normal, np.einsum("nk,nkc->nc", weights, mesh.normals[mesh.faces[prim]]))


def _on_unit(surface: Quadric, o: Float, d: Float, t: Float) -> Exact:
    if surface.is_flat:
        normal = np.broadcast_to(np.array([0.0, 0.0, 1.0]), d.shape)
        return Exact(-o[2] / d[:, 2], normal, normal)
    axes = _ROUND_AXES[surface.kind]
    o_round, d_round = o[:axes], d[:, :axes]
    roots = _quadratic(_dot(d_round, d_round), _dot(d_round, o_round), np.broadcast_to(o_round @ o_round - 1, len(d)))
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
            if surface is not None and body.instance is not None:  # instances share the vertices of their shape
                surface = replace(surface, world_from_local=_pose(body.instance) @ surface.world_from_local)
            placed.append(surface)
        built.cache["surfaces"] = placed
    found: list[Surface | None] = built.cache["surfaces"]
    return found


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
        normals if len(normals) and shape.has_vertex_normals() and not shape.has_face_normals() else None,
        np.eye(4),
    )


def _pose(shape: Any) -> Float:
    matrix = mitsuba().traverse(shape)["to_world"].matrix
    return np.asarray(matrix, dtype=np.float64).reshape(4, 4)
