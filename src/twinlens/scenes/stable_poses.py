"""Stable poses of meshes on level ground, and distances of convex outlines in the plane.

A body at rest has a face of its convex hull on the ground, with its centre of mass above that face. How probable the
pose is follows from the quasi-static model: the body lands on the face that a random direction from its centre of mass
meets, and tips from face to face until it is at rest. A finer mesh of a round body has more poses, each less probable;
the sum over its wall stays.

Its footprint is the convex hull of its vertices seen from above; bodies whose footprints are apart cannot intersect.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull

from twinlens.geometry import Float
from twinlens.scenes import shapes
from twinlens.scenes.scene import Mesh

Ids = NDArray[np.intp]

# Lengths in units of the body's size.
_SAME_PLANE = 1e-5  # points nearer to the ground touch it
_SAME_CENTRE = 1e-3  # the centroids of a closed mesh differ by rounding only
_MIN_MARGIN = 2e-3  # a body that is nearer to an edge tips if it ends lower by more
_SAME_FACE = 2e-4  # radians: neighbours of a smaller angle are one face
_ROLLS = np.radians(10)  # facets of a smaller angle are those of a round body


@dataclass(frozen=True, eq=False)
class _Body:
    """The vertices (N, 3) and triangles (F, 3) of a mesh, its hull points (M, 3), centre of mass (3,) and size."""

    vertices: Float
    faces: NDArray[np.uint32]
    points: Float
    centre: Float
    size: float


@dataclass(frozen=True, eq=False)
class StablePose:
    """A body at rest on the face of its hull with the outward unit normal `down` (3,), in the body's axes.

    The probabilities of all poses of a body have the sum 1. Everything else is computed when it is read, as round
    bodies have thousands of poses.
    """

    body: _Body
    down: Float
    probability: float

    @property
    def up(self) -> Float:
        """The direction (3,) in the body's axes that points up, the third row of `turn`."""
        return -self.down

    @cached_property
    def turn(self) -> Float:
        """The rotation (3, 3) from the body's axes to those of the ground."""
        return _turn_down(self.down)

    @cached_property
    def _lift(self) -> Float:
        """The offset (3,) that takes the lowest rotated point to z = 0."""
        return np.array([0.0, 0.0, float((self.body.points @ self.down).max())])

    @property
    def points(self) -> Float:
        """The rotated hull points (N, 3), the lowest one at z = 0; not kept, as they are many."""
        return np.asarray(self.body.points @ self.turn.T + self._lift)

    @cached_property
    def centre(self) -> Float:
        """The rotated centre of mass (3,)."""
        return np.asarray(self.turn @ self.body.centre + self._lift)

    @cached_property
    def support(self) -> Float:
        """The contact polygon (N, 2)."""
        points = self.points
        near = _SAME_PLANE * self.body.size
        return outline(points[points[:, 2] < near, :2])

    @cached_property
    def top(self) -> Float | None:
        """The outline (N, 2) of the level face on top, None if there is none."""
        points = self.points
        highest = points[:, 2].max() - _SAME_PLANE * self.body.size
        top = _polygon(points[points[:, 2] > highest, :2])
        return top if top is not None and _is_solid(self, top) else None

    @cached_property
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
    """A mean (3,) over tetrahedra with a corner at the origin, which has no effect if the triangles are closed.

    The tetrahedron of the origin and a triangle a, b, c has the signed volume a . (b x c) / 6 and the centroid
    (a + b + c) / 4. Those of a closed surface add up to the solid, whichever their common corner.
    """
    a, b, c = np.moveaxis(triangles, 1, 0)
    volume = np.einsum("nc,nc->n", a, np.cross(b, c))
    with np.errstate(divide="ignore", invalid="ignore"):
        moment = (volume[:, None] * (a + b + c)).sum(axis=0)
        return np.asarray(moment / (4 * volume.sum()))


def stable_poses(mesh: Mesh, size: float = 1.0) -> list[StablePose]:
    """The stable poses of a mesh scaled by `size`, the most probable one first.

    Source: Goldberg et al., Part pose statistics: estimators and experiments, IEEE Transactions on Robotics and
    Automation 15(5), 1999.
    """
    vertices = mesh.vertices * size
    hull = ConvexHull(vertices)
    points = vertices[hull.vertices]
    centre = centre_of_mass(mesh) * size
    if np.any(hull.equations[:, :3] @ centre + hull.equations[:, 3] > 0):
        centre = points.mean(axis=0)  # parts of the mesh are inside out
    body = _Body(vertices, mesh.faces, points, centre, size)
    faces = _faces(hull, centre)
    rest_of = _resting_face(faces, size)
    probability = np.bincount(rest_of, faces.share, minlength=len(faces.share))
    stable = np.flatnonzero(probability)
    # Rounded, so that the order of equal faces does not depend on the machine.
    x, y, z = np.round(faces.normal[stable].T, 6) + 0.0
    order = stable[np.lexsort((z, y, x, -np.round(probability[stable], 9)))]
    return [StablePose(body, faces.normal[i], float(probability[i])) for i in order]


@dataclass(frozen=True, eq=False)
class _Faces:
    """The N faces of a hull, and the E edges between faces, listed once from each side.

    normal (N, 3) : outward, of the triangle below the centre of mass where there is one.
    share (N,) : of all directions from the centre of mass, those that meet the face.
    height (N,) : of the centre of mass above the face.
    side, beyond (E,) : the face that the edge is listed for, and its neighbour there.
    bend (E,) : the angle between the two faces, radians.
    inside (E,) : how far the centre of mass, seen from above the face, lies inside of the edge; negative outside.
    ahead (E,) : whether the way from the middle of the face to below the centre of mass leads to this edge.
    """

    normal: Float
    share: Float
    height: Float
    side: Ids
    beyond: Ids
    bend: Float
    inside: Float
    ahead: NDArray[np.bool_]


def _faces(hull: ConvexHull, centre: Float) -> _Faces:
    """The faces of a hull, of neighbouring triangles in one plane, as seen from the centre of mass (3,)."""
    corners = hull.points[hull.simplices] - centre
    normal, offset = hull.equations[:, :3], hull.equations[:, 3]
    height = -(normal @ centre + offset)
    face_of, middle = _same_planes(hull, corners)

    # The edges of all triangles. Triangle i meets triangle neighbors[i, k] opposite to its corner k.
    triangle = np.repeat(np.arange(len(corners)), 3)
    neighbor = hull.neighbors.ravel()
    side, beyond = face_of[triangle], face_of[neighbor]
    out = normal[triangle]
    start, end = _edges(corners, out, middle[side])

    # Below the centre of mass, which is the origin, in the plane of the triangle.
    foot = height[triangle, None] * out
    along = end - start
    inward = np.cross(out, along) / np.linalg.norm(along, axis=1, keepdims=True)
    inside = _dot(foot - start, inward)
    way = foot - middle[side]
    ahead = _triple(out, start - middle[side], way) >= 0
    ahead &= _triple(out, way, end - middle[side]) >= 0
    chord = np.linalg.norm(out - normal[neighbor], axis=1)
    bend = 2 * np.arcsin(np.minimum(chord / 2, 1))

    # The normal of a face is that of its triangle that the centre of mass is above, or nearest to it.
    depth = inside.reshape(-1, 3).min(axis=1)
    order = np.lexsort((-depth, face_of))
    below = order[np.unique(face_of[order], return_index=True)[1]]
    border = side != beyond
    return _Faces(
        normal=normal[below],
        share=np.bincount(face_of, _solid_angles(corners)) / (4 * np.pi),
        height=height[below],
        side=side[border],
        beyond=beyond[border],
        bend=bend[border],
        inside=inside[border],
        ahead=ahead[border],
    )


def _edges(corners: Float, normal: Float, middle: Float) -> tuple[Float, Float]:
    """The ends (3F, 3) of the edges of triangles (F, 3, 3), opposite to their corners 0, 1 and 2.

    Counter-clockwise about the middle (3F, 3) of the edge's face with that outward normal: Qhull does not orient
    triangles.
    """
    start = np.roll(corners, -1, axis=1).reshape(-1, 3)
    end = np.roll(corners, -2, axis=1).reshape(-1, 3)
    is_clockwise = _triple(normal, start - middle, end - middle) < 0
    swap = is_clockwise[:, None]
    return np.where(swap, end, start), np.where(swap, start, end)


def _same_planes(hull: ConvexHull, corners: Float) -> tuple[Ids, Float]:
    """The face (F,) of each triangle of a hull with corners (F, 3, 3), and the centroid (N, 3) of each face."""
    count = len(corners)
    first = np.repeat(np.arange(count), 3)
    second = hull.neighbors.ravel()
    bend = hull.equations[first, :3] - hull.equations[second, :3]
    is_flat = np.linalg.norm(bend, axis=1) < _SAME_FACE
    pairs = first[is_flat], second[is_flat]
    links = coo_array((np.ones(is_flat.sum()), pairs), shape=(count, count))
    faces, face_of = connected_components(links, directed=False)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    # A face without an area has the mean of its triangles.
    weight = np.maximum(np.linalg.norm(cross, axis=1), np.finfo(float).tiny)
    weighted = weight[:, None] * corners.mean(axis=1)
    total = np.stack([np.bincount(face_of, axis, faces) for axis in weighted.T], axis=1)
    middle = total / np.bincount(face_of, weight, faces)[:, None]
    return face_of.astype(np.intp), middle


def _solid_angles(triangles: Float) -> Float:
    """The solid angles (F,) of triangles (F, 3, 3) at the origin.

    tan(angle / 2) = |a . (b x c)| / (|a| |b| |c| + (a . b) |c| + (b . c) |a| + (c . a) |b|).
    Source: Van Oosterom and Strackee, IEEE Transactions on Biomedical Engineering 30(2), 1983.
    """
    a, b, c = np.moveaxis(triangles, 1, 0)
    lengths = np.linalg.norm(triangles, axis=2)
    p, q, r = lengths.T
    volume = np.abs(_triple(a, b, c))
    ab, bc, ca = _dot(a, b), _dot(b, c), _dot(c, a)
    projected = p * q * r + ab * r + bc * p + ca * q
    return np.asarray(2 * np.arctan2(volume, projected))


def _resting_face(faces: _Faces, size: float) -> Ids:
    """The face (N,) that a body comes to rest on, for each face that it lands on."""
    # The centre of mass is beyond an edge: the body tips over it, and gets lower. Without this order, rounding could
    # lead around in a circle.
    gets_lower = faces.height[faces.beyond] < faces.height[faces.side]
    tips = faces.ahead & (faces.inside < 0) & gets_lower
    following = np.arange(len(faces.height))
    following[faces.side[tips]] = faces.beyond[tips]
    rest_of = _ends(following)

    pushed = _pushed(faces, rest_of, size)[rest_of]
    drop = faces.height[rest_of] - faces.height[pushed]
    return np.where(drop > _MIN_MARGIN * size, pushed, rest_of)


def _pushed(faces: _Faces, rest_of: Ids, size: float) -> Ids:
    """Where bodies at rest end after a push, wherever it brings them lower: `rest_of` (N,), changed.

    A push is enough over an edge that is nearly below the centre of mass: of a sheet on its rim, and between facets of
    a round body, which rolls. A level cylinder ends no lower.
    """
    is_near = faces.inside < _MIN_MARGIN * size
    is_round = faces.bend < _ROLLS
    is_round &= faces.inside < np.tan(_ROLLS / 2) * faces.height[faces.side]
    is_resting = rest_of[faces.side] == faces.side
    end_height = faces.height[rest_of[faces.beyond]]
    gets_lower = end_height < faces.height[faces.side]
    gives_way = np.flatnonzero((is_near | is_round) & is_resting & gets_lower)
    # Of several edges, the one beyond which the body ends lowest: the last one written.
    gives_way = gives_way[np.argsort(-end_height[gives_way], kind="stable")]
    following = rest_of.copy()
    following[faces.side[gives_way]] = rest_of[faces.beyond[gives_way]]
    return _ends(following)


def _ends(following: Ids) -> Ids:
    """The last item of the chain from each item (N,) to the one that follows it; the last is followed by itself."""
    while not np.array_equal(further := following[following], following):
        following = further
    return following


def _dot(a: Float, b: Float) -> Float:
    return np.asarray((a * b).sum(axis=-1))


def _triple(a: Float, b: Float, c: Float) -> Float:
    return _dot(a, np.cross(b, c))


def _is_solid(pose: StablePose, top: Float) -> bool:
    """Whether level triangles of the mesh fill the outline of its top; around a hollow, only a rim is there."""
    vertices, faces = pose.body.vertices, pose.body.faces
    cross = shapes.face_cross(vertices, faces)
    rise = cross @ pose.up
    level = rise > (1 - 1e-9) * np.linalg.norm(cross, axis=1)
    height = vertices @ pose.up
    is_high = height > height.max() - _SAME_PLANE * pose.body.size
    level &= is_high[faces[:, 0]]
    return bool(0.5 * rise[level].sum() >= 0.99 * _area(top))


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
    following = np.concatenate([convex[1:], convex[:1]])
    x, y = (following - convex).T
    # An edge (x, y) of a counter-clockwise outline has the outside on its right.
    lengths = np.sqrt(x * x + y * y)
    return np.asarray(np.stack([y, -x], axis=-1) / lengths[:, None])


def inside_by(convex: Float, point: Float) -> float:
    """How far a point lies inside a convex outline; negative outside."""
    return float(-((point - convex) * edge_normals(convex)).sum(axis=1).max())


def gap(a: Float, b: Float) -> float:
    """A lower bound of the distance of convex outlines (N, 2). Source: Gottschalk et al., OBBTree, SIGGRAPH 1996.

    Separating axes: along the outward normal of an edge, one outline ends at the edge, and the other begins at its
    point that is nearest in this direction. The largest of these gaps is positive if and only if the outlines are
    apart.
    """
    largest = -np.inf
    for first, second in ((a, b), (b, a)):
        normal = edge_normals(first)
        edge = (first * normal).sum(axis=1)
        nearest = (second @ normal.T).min(axis=0)
        largest = max(largest, float((nearest - edge).max()))
    return largest
