"""What rays meet, in float64: hits refined on the very primitive that was hit, and whether another place sees them.

Surfaces are read back from what Mitsuba traces, once a scene.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Rig
from twinlens.geometry import Float, inverse, rotate
from twinlens.rendering.backends import mitsuba
from twinlens.rendering.build import Body, BuiltScene
from twinlens.rendering.cast import Hits, cast, measured_normals
from twinlens.rendering.refine import FAR_OFF, FLAT_SHAPES, UNIT_SHAPES, Exact, Quadric, Triangles, refine

_SAME_POINT = 1e-5  # relative: the partner's ray ends at the same point if it ends within this share of its length


def exact_hits(built: BuiltScene, origin: Float, directions: Float, hits: Hits, measure: bool = True) -> Exact:
    """Every hit refined on the primitive that was hit: t, geometric and shading normals.

    Shapes without a closed form keep their t, and have normals only if asked to `measure` them.
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
            exact.normal[chosen], exact.shading_normal[chosen] = measured_normals(built, origin, directions[chosen])
            continue
        part = refine(surface, origin, directions[chosen], hits.prim[chosen], hits.t[chosen])
        exact.t[chosen], exact.normal[chosen], exact.shading_normal[chosen] = part.t, part.normal, part.shading_normal
    return exact


def _surface(built: BuiltScene, row: int, body: Body) -> Triangles | Quadric | None:
    """The body's surface in float64, read back from what Mitsuba traces; kept with the scene.

    Instances share the vertices of their shape.
    """
    key = f"surface{row}"
    if key not in built.cache:
        shared = None if body.shape is None else _shape_surface(built, body.shape)
        if shared is not None and body.instance is not None:
            shared = replace(shared, world_from_local=_to_world(body.instance) @ shared.world_from_local)
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
        return Quadric(kind, _to_world(shape))
    return _read_mesh(shape) if shape.is_mesh() else None


def _to_world(shape: Any) -> Float:
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


def sky_is_seen(built: BuiltScene, rig: Rig, other: int, directions: Float) -> NDArray[np.bool_]:
    """Whether camera `other` sees the points at infinity that world directions (N, 3) lead to."""
    pose = rig.world_from_cams[other]
    inside = rig.cameras[other].contains(rig.cameras[other].project(rotate(inverse(pose), directions)))
    seen: NDArray[np.bool_] = inside & (cast(built, pose[:3, 3], directions).body < 0)
    return seen


def unblocked(
    built: BuiltScene, centre: Float, points: Float, body: NDArray[np.int32], prim: NDArray[np.uint32]
) -> NDArray[np.bool_]:
    """Whether the first hit from `centre` towards each point is the point itself: the same flat piece, or as far.

    Near misses are refined: where a ray grazes a curved surface, float32 alone is further off than _SAME_POINT.
    """
    rays = points - centre
    hits = cast(built, centre, rays)
    surfaces = [_surface(built, row, thing) for row, thing in enumerate(built.bodies)]
    triangles, one_plane = (np.array([*map(test, surfaces), False]) for test in (_is_mesh, _is_plane))
    same_plane = (hits.body == body) & (one_plane[body] | (triangles[body] & (hits.prim == prim)))
    clear: NDArray[np.bool_] = same_plane | (hits.t >= 1 - _SAME_POINT)
    doubtful = np.flatnonzero(~clear & (hits.t >= 1 - 2 * FAR_OFF))
    near = Hits(hits.body[doubtful], hits.t[doubtful], hits.prim[doubtful])
    clear[doubtful] = exact_hits(built, centre, rays[doubtful], near, measure=False).t >= 1 - _SAME_POINT
    return clear


def _is_mesh(surface: Triangles | Quadric | None) -> bool:
    return isinstance(surface, Triangles)


def _is_plane(surface: Triangles | Quadric | None) -> bool:
    """Whether it is flat as a whole, and so cannot hide itself, however nearly it is seen edge on."""
    return isinstance(surface, Quadric) and surface.kind in FLAT_SHAPES
