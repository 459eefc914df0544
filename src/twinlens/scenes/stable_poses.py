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

# Lengths in units of the body's size.
_SAME_PLANE = 1e-5  # hull triangles whose planes differ by less are one face
_SAME_CENTRE = 1e-3  # the centroids of a closed mesh differ by rounding only
_MIN_MARGIN = 2e-3  # least distance of the centre of mass from the edge of the contact
_MAX_FACES = 12


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
    size = np.ptp(mesh.vertices, axis=0).max()
    # The sum over tetrahedra does not depend on their common corner if the mesh is closed. The second corner is outside
    # of the planes that the rim of an open mesh is likely to be in, where both sums would be those of a closed one.
    corner = mesh.vertices.max(axis=0) + size * np.array([1.0, 2.0, 3.0])
    about_origin = _solid_centroid(triangles)
    about_corner = _solid_centroid(triangles - corner) + corner
    if np.abs(about_corner - about_origin).max() < _SAME_CENTRE * size:
        return about_origin
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
    poses = []
    for plane in _candidate_planes(hull, centre, size):
        pose = _pose(points, centre, plane, size)
        if pose is None:
            continue
        if pose.top is not None and not _is_solid(pose, pose.top, vertices, mesh, size):
            pose = replace(pose, top=None)
        poses.append(pose)
    return sorted(poses, key=lambda pose: -pose.probability)


def _candidate_planes(hull: ConvexHull, centre: Float, size: float) -> Float:
    """Planes (N, 4) of the largest faces of the hull and of those nearest to the centre of mass.

    The nearest face of all is always stable. Triangles in one plane are one face.
    """
    scaled = hull.equations / [1, 1, 1, size]
    _, first, face_of = np.unique(
        np.round(scaled / (10 * _SAME_PLANE)),
        axis=0,
        return_index=True,
        return_inverse=True,
    )
    doubled_areas = np.linalg.norm(
        shapes.face_cross(hull.points, hull.simplices), axis=1
    )
    area = np.bincount(face_of.ravel(), doubled_areas)
    height = hull.equations[first] @ [*centre, 1.0]  # below the plane: negative
    # Rounded, so that the order of equal faces does not depend on the machine.
    largest = np.argsort(-np.round(area / size**2, 9), kind="stable")
    nearest = np.argsort(-np.round(height / size, 9), kind="stable")
    chosen = np.unique(np.concatenate([largest[:_MAX_FACES], nearest[:_MAX_FACES]]))
    return np.asarray(hull.equations[first[chosen]])


def _is_solid(
    pose: StablePose, top: Float, vertices: Float, mesh: Mesh, size: float
) -> bool:
    """Whether level triangles of the mesh fill the outline of its top; around a hollow, only a rim is there."""
    up = pose.turn[2]
    cross = shapes.face_cross(vertices, mesh.faces)
    rise = cross @ up
    level = rise > (1 - 1e-9) * np.linalg.norm(cross, axis=1)
    height = vertices[mesh.faces[:, 0]] @ up
    highest = (vertices @ up).max()
    level &= np.abs(height - highest) < _SAME_PLANE * size
    return bool(0.5 * rise[level].sum() >= 0.99 * _area(top))


def _pose(points: Float, centre: Float, plane: Float, size: float) -> StablePose | None:
    """The pose with `plane` on the ground, None where it is not stable; `top` is the outline of the highest points."""
    turn = _turn_down(plane[:3] / np.linalg.norm(plane[:3]))
    turned = points @ turn.T
    floor = turned[:, 2].min()
    turned[:, 2] -= floor
    balanced = turn @ centre - [0, 0, floor]
    contact = turned[turned[:, 2] < _SAME_PLANE * size, :2]
    above = balanced[:2]
    # The bounding box first: it rules out most faces without a convex hull.
    margins = above - contact.min(axis=0), contact.max(axis=0) - above
    if np.minimum(*margins).min() < _MIN_MARGIN * size:
        return None
    support = _polygon(contact)
    if support is None or inside_by(support, above) < _MIN_MARGIN * size:
        return None
    highest = turned[:, 2].max() - _SAME_PLANE * size
    top = _polygon(turned[turned[:, 2] > highest, :2])
    probability = _probability(support, float(balanced[2]))
    return StablePose(turn, turned, balanced, support, top, probability)


def _turn_down(normal: Float) -> Float:
    """The smallest rotation (3, 3) that takes a unit normal (3,) to -z; about the x axis for +z itself."""
    x, y, z = normal
    if z > 1 - 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    # Rodrigues's formula with the axis n x (-z) = (-y, x, 0) and the cosine -z.
    k = 1 / (1 - z)
    return np.array(
        [
            [1 - k * x * x, -k * x * y, x],
            [-k * x * y, 1 - k * y * y, y],
            [-x, -y, -z],
        ]
    )


def _probability(support: Float, height: float) -> float:
    """About the solid angle of a face of the contact's area as seen from the centre of mass, `height` above it."""
    area = _area(support)
    return area / (height**2 + area)


def _area(convex: Float) -> float:
    x, y = convex.T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def _polygon(points: Float) -> Float | None:
    """The outline (N, 2) of points in the plane; None if they are on one line."""
    if len(points) < 3:
        return None
    tolerance = 1e-7 * max(1e-9, np.ptp(points))
    rank = np.linalg.matrix_rank(points - points.mean(axis=0), tol=tolerance)
    return None if rank < 2 else outline(points)


def edge_normals(convex: Float) -> Float:
    """The outward unit normals (N, 2) of a convex outline (N, 2), counter-clockwise."""
    x, y = (np.concatenate([convex[1:], convex[:1]]) - convex).T
    return np.asarray(np.stack([y, -x], axis=-1) / np.sqrt(x * x + y * y)[:, None])


def inside_by(convex: Float, point: Float) -> float:
    """How far a point lies inside a convex outline; negative outside."""
    return float(-((point - convex) * edge_normals(convex)).sum(axis=1).max())


def gap(a: Float, b: Float) -> float:
    """A lower bound of the distance of convex outlines (N, 2). Source: Gottschalk et al., OBBTree, SIGGRAPH 1996."""
    largest = -np.inf
    for first, second in ((a, b), (b, a)):
        normal = edge_normals(first)
        edge = (first * normal).sum(axis=1)
        nearest = (second @ normal.T).min(axis=0)
        largest = max(largest, float((nearest - edge).max()))
    return largest
