"""Whether a point is inside a body of a scene, by the crossing number of a ray."""

import numpy as np
from numpy.typing import NDArray

from twinlens.geometry import Float, inverse, transform_points
from twinlens.scenes import Mesh, Scene, SceneObject

_DIRECTION = np.array([0.30151134, 0.90453403, 0.30151134])  # unlikely to be parallel to an edge
_CLOSED = ("sphere", "cube")


def encloses(scene: Scene, name: str, point: Float) -> bool:
    """Whether `point` (3,), in world coordinates, is inside the body that the ground truth calls `name`.

    Only spheres, cubes and meshes have an inside. False for scenes from Mitsuba files, whose shapes are not read.
    """
    for thing in scene.objects:
        for part, pose in _appearances(thing):
            if part == name:
                return _is_inside(thing, transform_points(inverse_of(pose), point))
    return False


def inverse_of(pose: Float) -> Float:
    """The inverse of any invertible pose: objects may be scaled, which a rigid inverse would not see."""
    rigid = np.allclose(pose[:3, :3].T @ pose[:3, :3], np.eye(3))
    return inverse(pose) if rigid else np.asarray(np.linalg.inv(pose))


def _appearances(thing: SceneObject) -> list[tuple[str, Float]]:
    if not thing.instances:
        return [(thing.name, thing.world_from_object)]
    return [(f"{thing.name}[{i}]", pose @ thing.world_from_object) for i, pose in enumerate(thing.instances)]


def _is_inside(thing: SceneObject, point: Float) -> bool:
    shape = thing.shape
    if isinstance(shape, Mesh):
        return crossings(shape.vertices, shape.faces, point) % 2 == 1
    if shape["type"] not in _CLOSED:
        return False
    if shape["type"] == "cube":
        return bool(np.abs(_own(shape, point)).max() < 1)
    centre, radius = np.asarray(shape.get("center", (0, 0, 0)), dtype=np.float64), float(shape.get("radius", 1.0))
    return bool(np.linalg.norm(_own(shape, point) - centre) < radius)


def _own(shape: object, point: Float) -> Float:
    pose = shape.get("to_world") if hasattr(shape, "get") else None
    return point if pose is None else transform_points(np.linalg.inv(pose), point)


def crossings(vertices: Float, faces: NDArray[np.uint32], origin: Float) -> int:
    """How many triangles a ray from `origin` (3,) crosses. Source: Moeller and Trumbore 1997."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    ab, ac = b - a, c - a
    across = np.cross(_DIRECTION, ac)
    det = np.einsum("nc,nc->n", ab, across)
    with np.errstate(divide="ignore", invalid="ignore"):
        to = origin - a
        u = np.einsum("nc,nc->n", to, across) / det
        turned = np.cross(to, ab)
        v = turned @ _DIRECTION / det
        t = np.einsum("nc,nc->n", ac, turned) / det
    return int(np.count_nonzero((u >= 0) & (v >= 0) & (u + v < 1) & (t > 0)))
