"""Places on the level faces of a scene's objects for bodies in stable poses, clear of everything else.

A body is at rest where its whole contact polygon lies on a level face. It is clear where the upright prism over its
footprint meets no triangle of the scene.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from twinlens.geometry import Float, transform_points
from twinlens.scenes import shapes
from twinlens.scenes.scene import Mesh, SceneObject
from twinlens.scenes.stable_poses import StablePose, edge_normals, inside_by

CLEARANCE = 1e-4  # of a body's size: gap between bodies that touch, so that no two surfaces coincide
_SPACING = 0.01  # of a body's size: least horizontal distance from other bodies
_LEVEL = 1e-9  # 1 - cosine of the largest slope of a level triangle
_SAME_HEIGHT = 1e-5  # of the object's size
_OUTSIDE = 1.001  # radius of a tessellated sphere or cylinder that is outside of the round one everywhere


def world_triangles(thing: SceneObject) -> list[Float]:
    """The triangles (F, 3, 3) of each copy of an object, in the world; those of a sphere or cylinder enclose it."""
    mesh = thing.shape
    if not isinstance(mesh, Mesh):
        mesh = shapes.tessellated(
            {**mesh, "radius": _OUTSIDE * mesh.get("radius", 1.0)}
        )
    poses = [pose @ thing.world_from_object for pose in thing.instances] or [
        thing.world_from_object
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
        turns = np.stack(
            [_cross(q - p, point - p) for p, q in ((a, b), (b, c), (c, a))]
        )
        if not ((turns >= 0).all(axis=0) | (turns <= 0).all(axis=0)).any():
            return False
        return not _segments_meet(self.edges, polygon).any()


def _cross(a: Float, b: Float) -> Float:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def _segments_meet(segments: Float, polygon: Float) -> Float:
    """Whether segments (E, 2, 2) enter a convex polygon. Source: Cyrus and Beck, Computer Graphics 7(4), 1978."""
    normals = edge_normals(polygon)
    offset = (polygon * normals).sum(axis=1)
    start, end = (
        segments[:, i] @ normals.T - offset for i in (0, 1)
    )  # distances outside of each edge
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = start / (start - end)
    enters = np.where(start > 0, np.where(end > 0, np.inf, crossing), 0.0).max(axis=1)
    leaves = np.where(end > 0, np.where(start > 0, -np.inf, crossing), 1.0).min(axis=1)
    return np.asarray(enters < leaves)


def level_faces(triangles: Float) -> list[LevelFace]:
    """The level faces of triangles (F, 3, 3) that face upwards, or downwards if none does; the largest one first."""
    cross = np.cross(
        triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    )
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
    corners = np.round(flat / same).astype(
        np.int64
    )  # vertices of neighbours are equal up to rounding
    _, ids = np.unique(corners.reshape(-1, 2), axis=0, return_inverse=True)
    ids = ids.reshape(-1, 3)
    pairs = np.concatenate([ids[:, [0, 1]], ids[:, [1, 2]], ids[:, [2, 0]]])
    ends = np.concatenate([flat[:, [0, 1]], flat[:, [1, 2]], flat[:, [2, 0]]])
    _, first, count = np.unique(
        np.sort(pairs, axis=1), axis=0, return_index=True, return_counts=True
    )
    return LevelFace(
        flat, float(triangles[..., 2].max()), area, ends[first[count == 1]]
    )


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
            inside_by(each.moved(each.rest.support), centre) > 0
            for each in self.stack[1:]
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
        near = (triangles.max(axis=1) >= low).all(axis=1) & (
            triangles.min(axis=1) <= high
        ).all(axis=1)
        found, flat = triangles[near], triangles[near][..., :2]
        normals = edge_normals(outline)
        apart = (
            (flat @ normals.T).min(axis=1) > (outline * normals).sum(axis=1) + margin
        ).any(axis=1)
        found, flat = found[~apart], flat[~apart]
        edges = np.roll(flat, -1, axis=1) - flat
        across = np.stack([edges[..., 1], -edges[..., 0]], axis=-1)
        length = np.linalg.norm(across, axis=-1)
        own = (across[:, :, None] * flat[:, None]).sum(axis=-1)  # edge, corner
        other = across @ outline.T
        apart = (own.min(axis=2) > other.max(axis=2) + margin * length) & (length > 0)
        apart |= (own.max(axis=2) < other.min(axis=2) - margin * length) & (length > 0)
        found = found[~apart.any(axis=1)]
        normal = np.cross(found[:, 1] - found[:, 0], found[:, 2] - found[:, 0])
        level = (normal * found[:, 0]).sum(axis=1)
        reach = normal[:, :2] @ outline.T
        rise = normal[:, 2:] * [bottom, top]
        least, most = (
            reach.min(axis=1) + rise.min(axis=1),
            reach.max(axis=1) + rise.max(axis=1),
        )
        slack = margin * np.linalg.norm(normal[:, :2], axis=1)
        return bool(((least - slack <= level) & (level <= most + slack)).any())


def near_triangles(
    obstacles: Sequence[Float], face: LevelFace, rest: StablePose
) -> Float:
    """The triangles (F, 3, 3) of all obstacles that a body in this pose on this face could meet."""
    reach = rest.reach + _SPACING * rest.size
    flat = face.triangles.reshape(-1, 2)
    low = np.append(flat.min(axis=0) - reach, face.height)
    high = np.append(flat.max(axis=0) + reach, face.height + 2 * rest.height)
    kept = [
        part[
            (part.max(axis=1) >= low).all(axis=1)
            & (part.min(axis=1) <= high).all(axis=1)
        ]
        for part in obstacles
    ]
    return np.concatenate(kept) if kept else np.empty((0, 3, 3))


def random_point(face: LevelFace, rng: np.random.Generator) -> Float:
    """A point (2,) of the face, uniform in its area."""
    a, b, c = face.triangles[rng.choice(len(face.area), p=face.area / face.area.sum())]
    u, v = rng.random(2)
    return np.asarray(
        a
        + (b - a) * (u if u + v < 1 else 1 - u)
        + (c - a) * (v if u + v < 1 else 1 - v)
    )
