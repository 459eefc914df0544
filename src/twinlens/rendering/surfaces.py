"""Surfaces in closed form, read from Mitsuba's shapes, and their intersection with rays in float64.

Mitsuba says which primitive a ray hits, in float32. Here the same primitive is intersected again in float64. Triangles
are intersected by their planes. Spheres, cylinders, disks and rectangles are intersected in their own unit space, where
they are the same for every pose: an affine map changes neither the parameter t of a ray nor the order of its hits.
"""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinlens.geometry import Float
from twinlens.rendering.backends import mitsuba
from twinlens.rendering.build import BuiltScene

MAX_CORRECTION = 1e-3
"""Largest relative correction of Mitsuba's t. A larger one is an error of a grazing hit, and Mitsuba's t is kept."""

_ROUND_AXES = {"sphere": 3, "cylinder": 2}  # coordinates whose squares sum to 1
_QUADRICS = (*_ROUND_AXES, "disk", "rectangle")


@dataclass(frozen=True, eq=False)
class Triangles:
    """A mesh: vertices (V, 3), faces (F, 3), vertex normals (V, 3) or None, all in the space of `world_from_local`.

    The world is here that of Mitsuba's scene: the frame of the built scene.
    """

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
    """Hits in float64: t (N,), geometric and shading normals (N, 3), unit, in world coordinates."""

    t: Float
    normal: Float
    shading_normal: Float


def refine(
    surface: Surface,
    origin: Float,
    direction: Float,
    prim: NDArray[np.uint32],
    t: Float,
) -> Exact:
    """The hits of origin + t direction (N, 3) with `surface`, near the float32 parameters t (N,)."""
    local_from_world: Float = np.linalg.inv(surface.world_from_local).astype(np.float64)
    linear = local_from_world[:3, :3]
    local_origin = origin @ linear.T + local_from_world[:3, 3]
    local_direction = direction @ linear.T
    with np.errstate(divide="ignore", invalid="ignore"):
        if isinstance(surface, Triangles):
            exact = _on_triangles(surface, local_origin, local_direction, prim)
        else:
            exact = _on_quadric(surface, local_origin, local_direction, t)
        is_small = np.abs(exact.t - t) <= MAX_CORRECTION * t
    return Exact(
        np.where(is_small, exact.t, t),
        _normal_in_world(exact.normal, linear),
        _normal_in_world(exact.shading_normal, linear),
    )


def _normal_in_world(normal: Float, local_from_world: Float) -> Float:
    # Normals turn by the inverse transpose of world_from_local; row vectors take its transpose.
    turned: Float = normal @ local_from_world
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    return turned


def _on_triangles(
    mesh: Triangles, origin: Float, direction: Float, prim: NDArray[np.uint32]
) -> Exact:
    """The planes of the triangles `prim` (N,), and normals by barycentric coordinates. Normals are not unit.

    The ray o + t d meets the plane through a with the normal n where (o + t d - a) . n = 0.
    """
    corners = mesh.vertices[mesh.faces[prim]]
    a = corners[:, 0]
    ab = corners[:, 1] - a
    ac = corners[:, 2] - a
    normal = np.cross(ab, ac)
    t = _dot(a - origin, normal) / _dot(direction, normal)
    if mesh.normals is None:
        return Exact(t, normal, normal)
    # The weight of a corner is the area of the triangle opposite it over the whole, both signed along the normal.
    from_a = origin + t[:, None] * direction - a
    squared_area = _dot(normal, normal)
    b = _dot(np.cross(from_a, ac), normal) / squared_area
    c = _dot(np.cross(ab, from_a), normal) / squared_area
    weights = np.stack([1 - b - c, b, c], axis=1)
    shading_normal = np.einsum("nk,nkc->nc", weights, mesh.normals[mesh.faces[prim]])
    return Exact(t, normal, shading_normal)


def _on_quadric(surface: Quadric, origin: Float, direction: Float, t: Float) -> Exact:
    """The plane z = 0, or the root near t of x^2 + y^2 [+ z^2] = 1. Normals are not unit."""
    if surface.is_flat:
        normal = np.broadcast_to(np.array([0.0, 0.0, 1.0]), direction.shape)
        return Exact(-origin[:, 2] / direction[:, 2], normal, normal)
    axes = _ROUND_AXES[surface.kind]
    o = origin[:, :axes]
    d = direction[:, :axes]
    roots = _roots(_dot(d, d), _dot(d, o), _dot(o, o) - 1)
    error = np.abs(np.nan_to_num(roots, nan=np.inf) - t)
    nearest = np.argmin(error, axis=0)
    exact = np.take_along_axis(roots, nearest[None], axis=0)[0]
    # The gradient of the equation, over 2: the position without the coordinate along a cylinder's axis.
    normal = (origin + exact[:, None] * direction) * (np.arange(3) < axes)
    return Exact(exact, normal, normal)


def _roots(a: Float, half_b: Float, c: Float) -> Float:
    """Both roots (2, N) of a t^2 + 2 half_b t + c = 0; NaN where there is none.

    q has no cancellation, and the product of the roots c/a gives the second one (Press et al., Numerical Recipes, 5.6).
    """
    q = -(half_b + np.copysign(np.sqrt(half_b**2 - a * c), half_b))
    return np.stack([q / a, c / q])


def _dot(a: Float, b: Float) -> Float:
    return np.asarray((a * b).sum(axis=-1))


def surfaces(built: BuiltScene) -> list[Surface | None]:
    """The surface of each body, or None for a shape without a closed form; read from Mitsuba once for each scene."""
    if "surfaces" not in built.cache:
        by_shape: dict[int, Surface | None] = {}
        for body in built.bodies:
            if id(body.shape) not in by_shape:
                by_shape[id(body.shape)] = _read_surface(body.shape)
        built.cache["surfaces"] = [
            _placed(by_shape[id(body.shape)], body.instance) for body in built.bodies
        ]
    return built.cache["surfaces"]  # type: ignore[no-any-return]


def _placed(surface: Surface | None, instance: Any) -> Surface | None:
    """The surface in the pose of its instance. Instances share the vertices of their shape."""
    if surface is None or instance is None:
        return surface
    pose = pose_of(instance) @ surface.world_from_local
    return replace(surface, world_from_local=pose)


def _read_surface(shape: Any) -> Surface | None:
    if shape is None:  # an instance in a Mitsuba file, whose shape is unknown
        return None
    mi = mitsuba()
    kind = mi.ShapeType(shape.shape_type()).name.lower()
    if kind in _QUADRICS:
        return Quadric(kind, pose_of(shape))
    if not shape.is_mesh():
        return None
    buffers = mi.traverse(shape)
    vertices = np.asarray(buffers["vertex_positions"], dtype=np.float64).reshape(-1, 3)
    faces = np.asarray(buffers["faces"], dtype=np.uint32).reshape(-1, 3)
    normals = None
    if shape.has_vertex_normals() and not shape.has_face_normals():
        normals = np.asarray(buffers["vertex_normals"], dtype=np.float64).reshape(-1, 3)
    return Triangles(vertices, faces, normals, np.eye(4))


def pose_of(shape: Any) -> Float:
    """The affine world_from_local (4, 4) of a Mitsuba shape or instance."""
    matrix = mitsuba().traverse(shape)["to_world"].matrix
    # Entry by entry: Dr.Jit would compile a kernel that writes these very numbers into one array.
    rows = [[matrix[i, j][0] for j in range(4)] for i in range(4)]
    return np.array(rows, dtype=np.float64)
