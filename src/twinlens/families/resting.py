"""Bodies at rest on a level surface: on which sides a body stays lying, and places where no two footprints meet.

A body rests on a face of its convex hull if its centre of mass lies above that face: the contact holds it. The
footprint is the convex hull of its shadow; bodies whose footprints are apart cannot intersect.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import ConvexHull

from twinlens.geometry import Float
from twinlens.scenes.scene import Mesh

Rng = np.random.Generator
_SAME_PLANE = 1e-5  # hull triangles whose planes agree to this are one face
_MOST_FACES = 12
_LEAST_MARGIN = 2e-3


@dataclass(frozen=True, eq=False)
class Rest:
    """A way to lie: the turn (3, 3), and points (N, 3) of the hull and its centre of mass afterwards, lowest at z = 0.

    `support` (N, 2) is the contact polygon, `top` (N, 2) the whole level face on top, or None, `height` the highest z.
    """

    turn: Float
    points: Float
    centre: Float
    support: Float
    top: Float | None
    likelihood: float
    margin: float

    @property
    def height(self) -> float:
        """How high it reaches."""
        return float(self.points[:, 2].max())

    @cached_property
    def footprint(self) -> Float:
        """The outline (N, 2) of its shadow, counter-clockwise."""
        return outline(self.points[:, :2])

    @cached_property
    def reach(self) -> float:
        """How far its shadow reaches from its place."""
        return float(np.linalg.norm(self.points[:, :2], axis=1).max())


def outline(points: Float) -> Float:
    """The convex hull (N, 2) of points in the plane, counter-clockwise."""
    return np.asarray(points[ConvexHull(points).vertices])


def centre_of_mass(mesh: Mesh) -> Float:
    """The centroid (3,) of a closed mesh's volume: tetrahedra to the origin, summed."""
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    volume = np.einsum("nc,nc->n", a, np.cross(b, c))
    return np.asarray((volume[:, None] * (a + b + c)).sum(axis=0) / (4 * volume.sum()))


def rests(mesh: Mesh, size: float = 1.0) -> list[Rest]:
    """Every side that a body of this mesh, `size` times as large, stays lying on, likeliest first.

    The likelihood of a face is the part of a small sphere around the centre of mass that it covers, as if the body were
    dropped at random. A face counts if the centre of mass lies inside it by a margin, 0.2% of the body's size.
    """
    vertices = mesh.vertices * size
    hull = ConvexHull(vertices)
    points = vertices[hull.vertices]
    centre = centre_of_mass(mesh) * size
    if np.any(hull.equations[:, :3] @ centre + hull.equations[:, 3] > 0):
        centre = points.mean(axis=0)  # a mesh that is not closed has no volume to speak of
    found = []
    level = _Faces.of(vertices, mesh)
    for plane in _planes(hull, centre, size):
        rest = _rest(points, centre, plane, size, level)
        if rest is not None:
            found.append(rest)
    return sorted(found, key=lambda rest: -rest.likelihood)


def _planes(hull: ConvexHull, centre: Float, size: float) -> Float:
    """The distinct planes (N, 4) of a hull's faces, the largest few and those nearest to its centre of mass, on one of
    which it always rests: a finely divided ball has thousands alike."""
    scaled = hull.equations / [1, 1, 1, size]
    _, first, same = np.unique(np.round(scaled / (10 * _SAME_PLANE)), axis=0, return_index=True, return_inverse=True)
    a, b, c = (hull.points[hull.simplices[:, i]] for i in range(3))
    area = np.bincount(same.ravel(), np.linalg.norm(np.cross(b - a, c - a), axis=1))
    largest = np.argsort(-np.round(area / size**2, 9), kind="stable")[:_MOST_FACES]
    nearest = np.argsort(-np.round(hull.equations[first] @ [*centre, 1.0] / size, 9), kind="stable")[:_MOST_FACES]
    return np.asarray(hull.equations[first[np.unique(np.concatenate([largest, nearest]))]])


@dataclass(frozen=True, eq=False)
class _Faces:
    """The triangles of a mesh: crosses of their sides (F, 3), and a corner (F, 3) each."""

    cross: Float
    corner: Float

    @classmethod
    def of(cls, vertices: Float, mesh: Mesh) -> "_Faces":
        a, b, c = (vertices[mesh.faces[:, i]] for i in range(3))
        return cls(np.cross(b - a, c - a), a)

    def area(self, direction: Float, height: float, size: float) -> float:
        """The area of those that face `direction` and lie `height` along it."""
        up = self.cross @ direction
        flat = up > (1 - 1e-9) * np.linalg.norm(self.cross, axis=1)
        there = np.abs(self.corner @ direction - height) < _SAME_PLANE * size
        return 0.5 * float(up[flat & there].sum())


def _rest(points: Float, centre: Float, plane: Float, size: float, faces: _Faces) -> Rest | None:
    turn = _downwards(plane[:3])
    turned, balanced = points @ turn.T, turn @ centre
    floor = turned[:, 2].min()
    turned[:, 2] -= floor
    balanced = balanced - [0, 0, floor]
    touching = turned[turned[:, 2] < _SAME_PLANE * size, :2]
    support = polygon(touching)
    if support is None:
        return None
    margin = inside_by(support, balanced[:2])
    if margin < _LEAST_MARGIN * size:
        return None
    top = polygon(turned[turned[:, 2] > turned[:, 2].max() - _SAME_PLANE * size, :2])
    if top is not None and faces.area(turn[2], float((points @ turn[2]).max()), size) < 0.99 * _area(top):
        top = None  # a rim, with nothing to stand on inside
    area, height = _area(support), float(balanced[2])
    return Rest(turn, turned, balanced, support, top, area / (height**2 + area), margin)


def _area(convex: Float) -> float:
    """Of an outline (N, 2). Source: the shoelace formula."""
    x, y = convex.T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def _downwards(normal: Float) -> Float:
    """The rotation (3, 3) that turns `normal` to -z by the shortest way."""
    x, y, z = normal / np.linalg.norm(normal)
    if z > 1 - 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    k = 1 / (1 - z)
    return np.array([[1 - k * x * x, -k * x * y, x], [-k * x * y, 1 - k * y * y, y], [-x, -y, -z]])


def polygon(points: Float) -> Float | None:
    """The convex outline of points, or None where they span no area."""
    if len(points) < 3 or np.linalg.matrix_rank(points - points.mean(axis=0), tol=1e-7 * max(1e-9, np.ptp(points))) < 2:
        return None
    return outline(points)


def inside_by(convex: Float, point: Float) -> float:
    """How far a point lies inside a convex outline; negative outside."""
    edge = np.roll(convex, -1, axis=0) - convex
    normal = np.stack([edge[:, 1], -edge[:, 0]], axis=-1) / np.linalg.norm(edge, axis=1, keepdims=True)
    return float(-((point - convex) * normal).sum(axis=1).max())


def gap(a: Float, b: Float) -> float:
    """A lower bound of the distance of two convex outlines (N, 2), positive where they are apart.

    The widest slab between them along the normals of their edges. Source: Gottschalk et al., OBBTree, SIGGRAPH 1996.
    """
    best = -np.inf
    for p, q in ((a, b), (b, a)):
        edge = np.roll(p, -1, axis=0) - p
        normal = np.stack([edge[:, 1], -edge[:, 0]], axis=-1) / np.linalg.norm(edge, axis=1, keepdims=True)
        reach = (p * normal).sum(axis=1)
        best = max(best, float(((q @ normal.T).min(axis=0) - reach).max()))
    return best


def turn_about_z(angle: float) -> Float:
    """The rotation (3, 3) about z."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
