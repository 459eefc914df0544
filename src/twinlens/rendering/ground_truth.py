"""Exact truth of every view: one chief ray a pixel, refined in float64, and one ray back to the partner.

pixel centres -> cast -> refine -> depth, position, normals, ids
                                     |-> project into the partner -> disparity
                                     |-> cast from the partner's centre -> visible
"""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Rig
from twinlens.geometry import Float, inverse, rotate, transform_points
from twinlens.rendering.backends import mitsuba
from twinlens.rendering.build import Body, BuiltScene, build
from twinlens.rendering.cast import Hits, cast, measured_normals
from twinlens.rendering.radiance import check_view
from twinlens.rendering.refine import FAR_OFF, FLAT_SHAPES, UNIT_SHAPES, Exact, Quadric, Triangles, refine
from twinlens.scenes import Scene
from twinlens.truth import Truth

_SAME_POINT = 1e-5  # relative: the partner's ray ends at the same point if it ends within this share of its length


def ground_truth(scene: Scene, rig: Rig, *, sky_disparity: bool = False) -> list[Truth]:
    """The exact truth of every camera of `rig`, towards its partner (`Rig.partner`). Lens and samples play no part.

    Parameters
    ----------
    sky_disparity : bool
        Give rays that hit nothing the disparity at infinity, -doffs, instead of +inf (unknown).

    Returns
    -------
    list of Truth, one a camera.
    """
    check_view(scene, rig)
    built = build(scene)
    return [_view_truth(built, rig, index, sky_disparity) for index in range(len(rig))]


def _view_truth(built: BuiltScene, rig: Rig, index: int, sky_disparity: bool) -> Truth:
    camera, pose = rig.cameras[index], rig.world_from_cams[index]
    origin = pose[:3, 3]
    directions = rotate(pose, camera.unproject(camera.pixel_grid())).reshape(-1, 3)
    hits = cast(built, origin, directions)
    exact = _exact(built, origin, directions, hits)
    found = hits.body >= 0
    position = np.full_like(directions, np.inf)
    position[found] = origin + exact.t[found, None] * directions[found]
    disparity, visible = _towards_partner(built, rig, index, hits, directions, position, sky_disparity)
    object_id, material_id, material_kind = _ids(built, hits.body)
    normal = _turned(exact.normal, -directions)

    def image(values: NDArray[Any], dtype: type[np.generic]) -> NDArray[Any]:
        return values.astype(dtype, copy=False).reshape(camera.height, camera.width, *values.shape[1:])

    return Truth(
        depth=image(exact.t, np.float64),
        position=image(position, np.float64),
        disparity=image(disparity, np.float32),
        visible=image(visible, np.bool_),
        normal=image(normal, np.float32),
        shading_normal=image(_turned(exact.shading_normal, normal), np.float32),
        object_id=image(object_id, np.int32),
        material_id=image(material_id, np.int32),
        material_kind=image(material_kind, np.uint8),
        object_names=built.object_names,
        material_names=built.material_names,
    )


def _turned(vectors: Float, towards: Float) -> Float:
    """Vectors (N, 3), those with the sign changed that point away from `towards`."""
    away = np.einsum("nc,nc->n", vectors, towards) < 0
    return np.where(away[:, None], -vectors, vectors)


def _exact(built: BuiltScene, origin: Float, directions: Float, hits: Hits, measure: bool = True) -> Exact:
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


def _towards_partner(
    built: BuiltScene, rig: Rig, index: int, hits: Hits, directions: Float, position: Float, sky_disparity: bool
) -> tuple[Float, NDArray[np.bool_]]:
    """(disparity, visible) of every pixel; without a partner all is unknown and unseen."""
    other = rig.partner(index)
    disparity = np.full(len(position), np.inf)
    visible = np.zeros(len(position), dtype=bool)
    if other is None:
        return disparity, visible
    found = hits.body >= 0
    camera, centre = rig.cameras[other], rig.world_from_cams[other][:3, 3]
    seen_px = camera.project(transform_points(inverse(rig.world_from_cams[other]), position[found]))
    left, right = (index, other) if rig.is_rectified(index, other) else (other, index)
    if rig.is_rectified(left, right):
        u = rig.cameras[index].pixel_grid()[..., 0].reshape(-1)
        disparity[found] = (u[found] - seen_px[:, 0]) * (1 if index == left else -1)
        if sky_disparity:
            disparity[~found] = -rig.doffs(left, right)
            visible[~found] = _sky_is_seen(built, rig, other, directions[~found])
    visible[found] = camera.contains(seen_px) & _unblocked(
        built, centre, position[found], hits.body[found], hits.prim[found]
    )
    return disparity, visible


def _sky_is_seen(built: BuiltScene, rig: Rig, other: int, directions: Float) -> NDArray[np.bool_]:
    """Whether camera `other` sees the points at infinity that world directions (N, 3) lead to."""
    pose = rig.world_from_cams[other]
    inside = rig.cameras[other].contains(rig.cameras[other].project(rotate(inverse(pose), directions)))
    seen: NDArray[np.bool_] = inside & (cast(built, pose[:3, 3], directions).body < 0)
    return seen


def _unblocked(
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
    unblocked: NDArray[np.bool_] = same_plane | (hits.t >= 1 - _SAME_POINT)
    doubtful = np.flatnonzero(~unblocked & (hits.t >= 1 - 2 * FAR_OFF))
    near = Hits(hits.body[doubtful], hits.t[doubtful], hits.prim[doubtful])
    unblocked[doubtful] = _exact(built, centre, rays[doubtful], near, measure=False).t >= 1 - _SAME_POINT
    return unblocked


def _is_mesh(surface: Triangles | Quadric | None) -> bool:
    return isinstance(surface, Triangles)


def _is_plane(surface: Triangles | Quadric | None) -> bool:
    """Whether it is flat as a whole, and so cannot hide itself, however nearly it is seen edge on."""
    return isinstance(surface, Quadric) and surface.kind in FLAT_SHAPES


def _ids(built: BuiltScene, body: NDArray[np.int32]) -> NDArray[np.int32]:
    """(object, material, kind) ids (3, N) of body rows; row -1 is nothing: 0."""
    table = [(row.object_id, row.material_id, row.material_kind) for row in built.bodies] + [(0, 0, 0)]
    ids: NDArray[np.int32] = np.array(table, dtype=np.int32).T[:, body]
    return ids
