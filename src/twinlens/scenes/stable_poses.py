"""Stable poses of meshes on level ground, and distances of convex outlines in the plane.

A body is stable on a face of its convex hull if its centre of mass lies above that face. Its footprint is the convex
hull of its vertices seen from above; bodies whose footprints are apart cannot intersect.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial import ConvexHull

from twinlens.geometry import Float
from twinlens.scenes import shapes
from twinlens.scenes.scene import Mesh

_SAME_PLANE = (
    1e-5  # of the body's size: hull triangles whose planes differ by less are one face
)
_MAX_FACES = 12
_SAME_CENTRE = (
    1e-3  # of the body's size: the centroids of a closed mesh differ by rounding only
)
_MIN_MARGIN = 2e-3  # of the body's size: least distance of the centre of mass from the edge of the contact


@dataclass(frozen=True, eq=False)
class StablePose:
    """A rotation (3, 3), and the rotated hull points (N, 3) and centre of mass (3,), with the lowest point at z = 0.

    `support` (N, 2) is the contact polygon, `top` (N, 2) the level face on top; `probability` is relative.
    """

    turn: Float
    points: Float
    centre: Float
    support: Float
    top: Float | None
    probability: float

    @property
    def height(self) -> float:
        return float(self.points[:, 2].max())

    @cached_property
    def size(self) -> float:
        """The largest extent along an axis."""
        return float(np.ptp(self.points, axis=0).max())

    @cached_property
    def footprint(self) -> Float:
        return outline(self.points[:, :2])

    @cached_property
    def reach(self) -> float:
        """The largest horizontal distance of a point from the z axis."""
        return float(np.linalg.norm(self.points[:, :2], axis=1).max())


def outline(points: Float) -> Float:
    """The convex hull (N, 2) of points in the plane, counter-clockwise."""
    return np.asarray(points[ConvexHull(points).vertices])


def centre_of_mass(mesh: Mesh) -> Float:
    """The centroid (3,) of a closed mesh's volume, or of the surface of a mesh that is not closed: a thin shell."""
    triangles = mesh.vertices[mesh.faces]
    solid, other = (
        _solid_centroid(triangles),
        _solid_centroid(triangles - mesh.vertices.max(axis=0)),
    )
    if (
        np.abs(other + mesh.vertices.max(axis=0) - solid).max()
        < _SAME_CENTRE * np.ptp(mesh.vertices, axis=0).max()
    ):
        return solid
    area = np.linalg.norm(shapes.face_cross(mesh.vertices, mesh.faces), axis=1)
    return np.asarray(area @ triangles.mean(axis=1) / area.sum())


def _solid_centroid(triangles: Float) -> Float:
    """A mean (3,) over tetrahedra with a corner at the origin, which has no effect if the triangles are closed."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    volume = np.einsum("nc,nc->n", a, np.cross(b, c))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(
            (volume[:, None] * (a + b + c)).sum(axis=0) / (4 * volume.sum())
        )


def stable_poses(mesh: Mesh, size: float = 1.0) -> list[StablePose]:
    """The stable poses of a mesh scaled by `size`; `probability` is about the solid angle of the face underneath."""
    vertices = mesh.vertices * size
    hull = ConvexHull(vertices)
    points = vertices[hull.vertices]
    centre = centre_of_mass(mesh) * size
    if np.any(hull.equations[:, :3] @ centre + hull.equations[:, 3] > 0):
        centre = points.mean(axis=0)  # parts of the mesh are inside out
    scaled = hull.equations / [1, 1, 1, size]
    _, first, same = np.unique(
        np.round(scaled / (10 * _SAME_PLANE)),
        axis=0,
        return_index=True,
        return_inverse=True,
    )
    area = np.bincount(
        same.ravel(),
        np.linalg.norm(shapes.face_cross(hull.points, hull.simplices), axis=1),
    )
    largest = np.argsort(-np.round(area / size**2, 9), kind="stable")[:_MAX_FACES]
    nearest = np.argsort(
        -np.round(hull.equations[first] @ [*centre, 1.0] / size, 9), kind="stable"
    )[:_MAX_FACES]
    cross, corner = shapes.face_cross(vertices, mesh.faces), vertices[mesh.faces[:, 0]]
    length = np.linalg.norm(cross, axis=1)
    found = []
    for index in np.unique(
        np.concatenate([largest, nearest])
    ):  # the face nearest to the centre of mass is stable
        pose = _pose(points, centre, hull.equations[first[index]], size)
        if pose is None:
            continue
        if pose.top is not None:
            up = pose.turn[2]
            rise = cross @ up
            level = rise > (1 - 1e-9) * length
            level &= np.abs(corner @ up - (points @ up).max()) < _SAME_PLANE * size
            if 0.5 * rise[level].sum() < 0.99 * _area(pose.top):
                pose = replace(pose, top=None)  # a rim around a hollow
        found.append(pose)
    return sorted(found, key=lambda pose: -pose.probability)


def _pose(points: Float, centre: Float, plane: Float, size: float) -> StablePose | None:
    """The pose with `plane` on the ground, None where it is not stable; `top` is the outline of the highest points."""
    x, y, z = plane[:3] / np.linalg.norm(plane[:3])
    turn = np.diag(
        [1.0, -1.0, -1.0]
    )  # the smallest rotation that takes the plane's normal to -z
    if z <= 1 - 1e-12:
        k = 1 / (1 - z)
        turn = np.array(
            [
                [1 - k * x * x, -k * x * y, x],
                [-k * x * y, 1 - k * y * y, y],
                [-x, -y, -z],
            ]
        )
    turned, balanced = points @ turn.T, turn @ centre
    floor = turned[:, 2].min()
    turned[:, 2] -= floor
    balanced = balanced - [0, 0, floor]
    contact = turned[turned[:, 2] < _SAME_PLANE * size, :2]
    if (
        np.minimum(
            balanced[:2] - contact.min(axis=0), contact.max(axis=0) - balanced[:2]
        ).min()
        < _MIN_MARGIN * size
    ):
        return None  # not even inside the contact's bounding box
    support = _polygon(contact)
    if support is None or inside_by(support, balanced[:2]) < _MIN_MARGIN * size:
        return None
    top = _polygon(turned[turned[:, 2] > turned[:, 2].max() - _SAME_PLANE * size, :2])
    area, height = _area(support), float(balanced[2])
    return StablePose(turn, turned, balanced, support, top, area / (height**2 + area))


def _area(convex: Float) -> float:
    x, y = convex.T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def _polygon(points: Float) -> Float | None:
    if (
        len(points) < 3
        or np.linalg.matrix_rank(
            points - points.mean(axis=0), tol=1e-7 * max(1e-9, np.ptp(points))
        )
        < 2
    ):
        return None
    return outline(points)


def edge_normals(convex: Float) -> Float:
    """The outward unit normals (N, 2) of a convex outline (N, 2), counter-clockwise."""
    x, y = (np.concatenate([convex[1:], convex[:1]]) - convex).T
    return np.asarray(np.stack([y, -x], axis=-1) / np.sqrt(x * x + y * y)[:, None])


def inside_by(convex: Float, point: Float) -> float:
    """How far a point lies inside a convex outline; negative outside."""
    return float(-((point - convex) * edge_normals(convex)).sum(axis=1).max())


def gap(a: Float, b: Float) -> float:
    """A lower bound of the distance of convex outlines (N, 2). Source: Gottschalk et al., OBBTree, SIGGRAPH 1996."""
    best = -np.inf
    for p, q in ((a, b), (b, a)):
        normal = edge_normals(p)
        best = max(
            best, float(((q @ normal.T).min(axis=0) - (p * normal).sum(axis=1)).max())
        )
    return best
