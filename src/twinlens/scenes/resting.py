"""Places on the level faces of a scene's objects for bodies in stable poses, clear of everything else.

A body is at rest where its whole contact polygon lies on a level face. It is clear where the upright prism over its
footprint meets no triangle of the scene.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from twinlens.geometry import Float, transform_points
from twinlens.scenes import shapes
from twinlens.scenes.scene import Mesh, SceneObject
from twinlens.scenes.stable_poses import StablePose, edge_normals, inside_by

CLEARANCE = 1e-4  # of a body's size: gap between bodies that touch, so that no two surfaces coincide
_SPACING = 0.01  # of a body's size: least horizontal distance from other bodies
_LEVEL = 1e-9  # 1 - cosine of the largest slope of a level triangle
_SAME_HEIGHT = 1e-5  # of the object's size
_OUTSIDE = 1.001  # radius of a tessellated sphere or cylinder that is outside of the round one everywhere


def world_triangles(scene_object: SceneObject) -> list[Float]:
    """The triangles (F, 3, 3) of each copy of an object, in the world; those of a sphere or cylinder enclose it."""
    mesh = scene_object.shape
    if not isinstance(mesh, Mesh):
        mesh = shapes.tessellated(
            {**mesh, "radius": _OUTSIDE * mesh.get("radius", 1.0)}
        )
    poses = [scene_object.world_from_object]
    if scene_object.instances:
        poses = [
            pose @ scene_object.world_from_object for pose in scene_object.instances
        ]
    return [transform_points(pose, mesh.vertices)[mesh.faces] for pose in poses]


@dataclass(frozen=True, eq=False)
class LevelFace:
    """Level triangles (T, 3, 2) at one `height`, their `area` (T,), and the edges (E, 2, 2) of their outline."""

    triangles: Float
    height: float
    area: Float
    edges: Float

    def holds(self, polygon: Float) -> bool:
        """Whether a convex polygon (N, 2), counter-clockwise, lies within the face."""
        a, b, c = np.moveaxis(self.triangles, 1, 0)
        point = polygon.mean(axis=0)
        edges = ((a, b), (b, c), (c, a))
        turns = np.stack([_cross(end - start, point - start) for start, end in edges])
        is_inside = (turns >= 0).all(axis=0) | (turns <= 0).all(axis=0)
        if not is_inside.any():
            return False
        return not _segments_meet(self.edges, polygon).any()


def _cross(a: Float, b: Float) -> Float:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def _segments_meet(segments: Float, polygon: Float) -> Float:
    """Whether segments (E, 2, 2) enter a convex polygon. Source: Cyrus and Beck, Computers and Graphics 3(1), 1978.

    A segment is inside between the last edge's line that it crosses inwards and the first one that it crosses outwards.
    """
    normals = edge_normals(polygon)
    offset = (polygon * normals).sum(axis=1)
    # Distances of both ends outside of each edge's line, and where along the segment it is crossed, 0 to 1.
    start, end = (segments[:, i] @ normals.T - offset for i in (0, 1))
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = start / (start - end)
    # Outside to the end, it never enters; inside from the start, it has entered at 0.
    enters = np.where(end > 0, np.inf, crossing)
    enters = np.where(start > 0, enters, 0.0).max(axis=1)
    leaves = np.where(start > 0, -np.inf, crossing)
    leaves = np.where(end > 0, leaves, 1.0).min(axis=1)
    return np.asarray(enters < leaves)


def level_faces(triangles: Float) -> list[LevelFace]:
    """The level faces of triangles (F, 3, 3) that face upwards, or downwards if none does; the largest one first."""
    first_edges = triangles[:, 1] - triangles[:, 0]
    second_edges = triangles[:, 2] - triangles[:, 0]
    cross = np.cross(first_edges, second_edges)
    length = np.linalg.norm(cross, axis=1)
    level = (np.abs(cross[:, 2]) > (1 - _LEVEL) * length) & (length > 0)
    up = level & (cross[:, 2] > 0)
    chosen = np.flatnonzero(up if up.any() else level)
    if not chosen.size:
        return []
    heights = triangles[chosen, :, 2].max(axis=1)
    order = np.argsort(heights, kind="stable")
    same = _SAME_HEIGHT * float(np.ptp(triangles.reshape(-1, 3), axis=0).max())
    groups = np.split(chosen[order], 1 + np.flatnonzero(np.diff(heights[order]) > same))
    faces = [
        _level_face(triangles[group], 0.5 * length[group], same) for group in groups
    ]
    return sorted(faces, key=lambda face: -float(face.area.sum()))


def _level_face(triangles: Float, area: Float, same: float) -> LevelFace:
    flat = triangles[..., :2]
    # Vertices of neighbours are equal up to rounding. An edge of one triangle alone is on the outline.
    corners = np.round(flat / same).astype(np.int64)
    _, ids = np.unique(corners.reshape(-1, 2), axis=0, return_inverse=True)
    ids = ids.reshape(-1, 3)
    sides = ([0, 1], [1, 2], [2, 0])
    pairs = np.concatenate([ids[:, side] for side in sides])
    ends = np.concatenate([flat[:, side] for side in sides])
    _, first, count = np.unique(
        np.sort(pairs, axis=1), axis=0, return_index=True, return_counts=True
    )
    height = float(triangles[..., 2].max())
    return LevelFace(flat, height, area, ends[first[count == 1]])


@dataclass(frozen=True, eq=False)
class Placed:
    """A stable pose rotated about z by `spin` (3, 3), with its lowest point at `place` (3,); `below` carries it."""

    rest: StablePose
    spin: Float
    place: Float
    below: "Placed | None" = None

    def moved(self, polygon: Float) -> Float:
        """An outline (N, 2) of the stable pose, in the world."""
        return np.asarray(polygon @ self.spin[:2, :2].T + self.place[:2])

    @cached_property
    def footprint(self) -> Float:
        return self.moved(self.rest.footprint)

    @property
    def top(self) -> float:
        return float(self.place[2] + self.rest.height)

    @property
    def stack(self) -> "list[Placed]":
        """This body and all bodies below it, from the top down."""
        return [self, *(self.below.stack if self.below else [])]

    def balanced(self) -> bool:
        """Whether its centre of mass is above the contact of every body that carries it."""
        centre = self.moved(self.rest.centre[None, :2])[0]
        return all(
            inside_by(carrier.moved(carrier.rest.support), centre) > 0
            for carrier in self.stack[1:]
        )

    def meets(self, triangles: Float) -> bool:
        """Whether the prism over the footprint, and a margin around it, meets any of the triangles (F, 3, 3).

        Separating axes: z, the edges of the footprint and of the triangles seen from above, and the triangles' normals.
        Other axes are not tested, so that some prisms that meet nothing are said to. Source: Gottschalk et al.,
        OBBTree, SIGGRAPH 1996.
        """
        outline, margin = self.footprint, _SPACING * self.rest.size
        bottom, top = self.place[2], self.top
        low = np.append(outline.min(axis=0) - margin, bottom)
        high = np.append(outline.max(axis=0) + margin, top)
        near = triangles[_boxes_meet(triangles, low, high)]
        near = near[~_apart_along_outline(near, outline, margin)]
        near = near[~_apart_along_edges(near, outline, margin)]

        # Along each triangle's normal: its plane, and the least and the largest value on the prism.
        normal = np.cross(near[:, 1] - near[:, 0], near[:, 2] - near[:, 0])
        plane = (normal * near[:, 0]).sum(axis=1)
        reach = normal[:, :2] @ outline.T
        rise = normal[:, 2:] * [bottom, top]
        least = reach.min(axis=1) + rise.min(axis=1)
        most = reach.max(axis=1) + rise.max(axis=1)
        slack = margin * np.linalg.norm(normal[:, :2], axis=1)
        return bool(((least - slack <= plane) & (plane <= most + slack)).any())


def _boxes_meet(triangles: Float, low: Float, high: Float) -> NDArray[np.bool_]:
    """Whether the bounding box of each triangle (F, 3, 3) meets the one from `low` to `high` (3,)."""
    above = (triangles.max(axis=1) >= low).all(axis=1)
    below = (triangles.min(axis=1) <= high).all(axis=1)
    return np.asarray(above & below)


def _apart_along_outline(
    triangles: Float, outline: Float, margin: float
) -> NDArray[np.bool_]:
    """Whether each triangle lies beyond an edge of the outline, seen from above."""
    normals = edge_normals(outline)
    edge = (outline * normals).sum(axis=1)
    nearest = (triangles[..., :2] @ normals.T).min(axis=1)
    return np.asarray((nearest > edge + margin).any(axis=1))


def _apart_along_edges(
    triangles: Float, outline: Float, margin: float
) -> NDArray[np.bool_]:
    """Whether the outline lies beyond an edge of each triangle, seen from above."""
    flat = triangles[..., :2]
    edges = np.roll(flat, -1, axis=1) - flat
    across = np.stack([edges[..., 1], -edges[..., 0]], axis=-1)
    length = np.linalg.norm(across, axis=-1)
    of_triangle = (across[:, :, None] * flat[:, None]).sum(axis=-1)  # edge, corner
    of_outline = across @ outline.T
    slack = margin * length
    apart = of_triangle.min(axis=2) > of_outline.max(axis=2) + slack
    apart |= of_triangle.max(axis=2) < of_outline.min(axis=2) - slack
    return np.asarray((apart & (length > 0)).any(axis=1))


def near_triangles(
    obstacles: Sequence[Float], face: LevelFace, rest: StablePose
) -> Float:
    """The triangles (F, 3, 3) of all obstacles that a body in this pose on this face could meet."""
    reach = rest.reach + _SPACING * rest.size
    flat = face.triangles.reshape(-1, 2)
    low = np.append(flat.min(axis=0) - reach, face.height)
    high = np.append(flat.max(axis=0) + reach, face.height + 2 * rest.height)
    kept = [part[_boxes_meet(part, low, high)] for part in obstacles]
    return np.concatenate(kept) if kept else np.empty((0, 3, 3))


def random_point(face: LevelFace, rng: np.random.Generator) -> Float:
    """A point (2,) of the face, uniform in its area."""
    share = face.area / face.area.sum()
    a, b, c = face.triangles[rng.choice(len(face.area), p=share)]
    u, v = rng.random(2)
    if not u + v < 1:  # the other half of the parallelogram
        u, v = 1 - u, 1 - v
    return np.asarray(a + (b - a) * u + (c - a) * v)
