"""Fine geometry: closed tubes along paths, thin sheets with height, leaf blades, and many copies of a mesh.

(u, v) are in metres on the surface, so that patterns have their real size.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.families.solids import double_sided
from twinlens.geometry import Float
from twinlens.scenes import shapes
from twinlens.scenes.scene import Mesh

_LEAF_THICKNESS = 2e-4  # metres
_QUAD = np.array([[0, 1, 2], [0, 2, 3]])


def tube(
    path: ArrayLike, radius: ArrayLike, sides: int = 10, closed: bool = False
) -> Mesh:
    """A closed round tube along one path (N, 3); see `tubes`."""
    points = np.asarray(path, dtype=np.float64)
    radii = np.broadcast_to(np.asarray(radius, dtype=np.float64), len(points))
    return tubes(points[None], radii[None], sides, closed)


def tubes(
    paths: ArrayLike, radius: ArrayLike, sides: int = 10, closed: bool = False
) -> Mesh:
    """Round tubes with flat ends along paths (B, N, 3) of distinct points; each is watertight.

    `radius` broadcasts to (B, N), in metres. `closed` joins the last point of each path to its first, without ends.
    Frames do not twist. Source: Wang et al., Computation of Rotation Minimizing Frames, ACM TOG 27(1), 2008.
    """
    centre = np.asarray(paths, dtype=np.float64)
    radii = np.broadcast_to(np.asarray(radius, dtype=np.float64), centre.shape[:2])
    if closed:
        centre = np.concatenate([centre, centre[:, :1]], axis=1)
        radii = np.concatenate([radii, radii[:, :1]], axis=1)
    tangent = _tangents(centre, closed)
    outward = _rings(centre, tangent, sides, closed)
    vertices = centre[:, :, None] + radii[:, :, None, None] * outward
    if closed:
        vertices[:, -1] = vertices[:, 0]
    uv = _unrolled(centre, radii, sides)
    count, rows = centre.shape[:2]
    faces = _faces_of_tubes(count, rows, sides)
    hose = Mesh(_points(vertices), faces, _points(outward), uv.reshape(-1, 2))
    if closed:
        return hose
    # A ring without its seam. The last one runs the other way round, as its end looks forwards.
    first_ring = vertices[:, 0, :-1]
    last_ring = vertices[:, -1, -2::-1]
    start = _ends(first_ring, centre[:, 0], -tangent[:, 0])
    end = _ends(last_ring, centre[:, -1], tangent[:, -1])
    return shapes.merged([hose, start, end])


def _rings(centre: Float, tangent: Float, sides: int, closed: bool) -> Float:
    """Unit vectors (B, N, sides + 1, 3) around paths (B, N, 3), across their tangents; the last is the first."""
    normal = _frames(centre, tangent, closed)
    binormal = np.cross(tangent, normal)
    angle = np.linspace(0, 2 * math.pi, sides + 1)
    cosine = np.cos(angle)[:, None]
    sine = np.sin(angle)[:, None]
    # The seam, where the angle is a full turn, has the positions of angle 0 to the last bit.
    cosine[-1] = cosine[0]
    sine[-1] = sine[0]
    return np.asarray(cosine * normal[:, :, None] + sine * binormal[:, :, None])


def _unrolled(centre: Float, radii: Float, sides: int) -> Float:
    """(u, v) in metres (B, N, sides + 1, 2): around a tube of mean radius, and along its path."""
    steps = np.linalg.norm(np.diff(centre, axis=1), axis=2)
    start = np.zeros((len(centre), 1))
    length = np.concatenate([start, steps.cumsum(axis=1)], axis=1)
    angle = np.linspace(0, 2 * math.pi, sides + 1)
    girth = angle * radii.mean(axis=1)[:, None]
    around, along = np.broadcast_arrays(girth[:, None], length[:, :, None])
    return np.stack([around, along], axis=-1)


def _faces_of_tubes(count: int, rows: int, sides: int) -> NDArray[np.uint32]:
    """Triangles of `count` tubes of `rows` rings, each of sides + 1 vertices."""
    columns = sides + 1
    one_tube = shapes.grid(columns, rows).astype(np.int64)
    return _repeated(one_tube, count, rows * columns)


def _points(grid: Float) -> Float:
    """A grid of points (..., 3) as a list (N, 3)."""
    return grid.reshape(-1, 3)


def _tangents(centre: Float, closed: bool) -> Float:
    """Unit tangents (B, N, 3): the mean direction of the steps before and after."""
    step = np.diff(centre, axis=1)
    step /= np.linalg.norm(step, axis=2, keepdims=True)
    first = step[:, :1]
    last = step[:, -1:]
    if closed:
        first = last = first + last
    inner = step[:, 1:] + step[:, :-1]
    total = np.concatenate([first, inner, last], axis=1)
    return np.asarray(total / np.linalg.norm(total, axis=2, keepdims=True))


def _frames(centre: Float, tangent: Float, closed: bool) -> Float:
    """Unit normals (B, N, 3) across the tangents, which turn about them as little as possible."""
    normal = np.empty_like(tangent)
    normal[:, 0] = _any_normal(tangent[:, 0])
    for i in range(tangent.shape[1] - 1):
        # Double reflection: in the plane between the two points, then in that between the two tangents.
        between = centre[:, i + 1] - centre[:, i]
        reflected = _reflected(normal[:, i], between)
        reflected_tangent = _reflected(tangent[:, i], between)
        normal[:, i + 1] = _reflected(reflected, tangent[:, i + 1] - reflected_tangent)
    if closed:
        _untwist(normal, tangent)
    return normal


def _any_normal(tangent: Float) -> Float:
    """Unit vectors (B, 3) across tangents (B, 3), near the axis that a tangent is farthest from."""
    farthest = np.abs(tangent).argmin(axis=1)
    axis = np.eye(3)[farthest]
    along = (axis * tangent).sum(axis=1, keepdims=True)
    across = axis - along * tangent
    return np.asarray(across / np.linalg.norm(across, axis=1, keepdims=True))


def _reflected(vectors: Float, across: Float) -> Float:
    """Vectors (B, 3) reflected in the planes with normals `across` (B, 3); unchanged where these are 0."""
    square = (across * across).sum(axis=1, keepdims=True)
    product = (across * vectors).sum(axis=1, keepdims=True)
    divisor = np.where(square > 1e-30, square, 1.0)
    return np.asarray(vectors - 2 * product / divisor * across)


def _untwist(normal: Float, tangent: Float) -> None:
    """Spread over the closed paths the angle by which their last frame differs from their first."""
    side = np.cross(tangent[:, 0], normal[:, 0])
    x = (normal[:, -1] * normal[:, 0]).sum(axis=1)
    y = (normal[:, -1] * side).sum(axis=1)
    twist = -np.arctan2(y, x)
    share = np.linspace(0, 1, normal.shape[1])
    angle = twist[:, None, None] * share[:, None]
    binormal = np.cross(tangent, normal)
    normal[:] = np.cos(angle) * normal + np.sin(angle) * binormal


def _ends(ring: Float, centre: Float, normal: Float) -> Mesh:
    """Flat fans over rings (B, sides, 3) that run clockwise as seen along `normal` (B, 3)."""
    count, sides = ring.shape[:2]
    vertices = np.concatenate([ring, centre[:, None]], axis=1)
    index = np.arange(sides)
    following = np.roll(index, -1)
    middle = np.full(sides, sides)
    fan = np.stack([following, index, middle], axis=-1)
    faces = _repeated(fan, count, sides + 1)
    normals = np.repeat(normal, sides + 1, axis=0)
    # (u, v) are the disc itself, in metres.
    radius = np.linalg.norm(ring - centre[:, None], axis=2, keepdims=True)
    angle = 2 * math.pi * index / sides
    rim = radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    uv = np.concatenate([rim, np.zeros((count, 1, 2))], axis=1)
    return Mesh(_points(vertices), faces, normals, uv.reshape(-1, 2))


def _repeated(faces: NDArray[np.int64], count: int, stride: int) -> NDArray[np.uint32]:
    """Faces (F, 3) of `count` parts whose vertices follow each other, `stride` a part."""
    starts = stride * np.arange(count)[:, None, None]
    return (faces + starts).reshape(-1, 3).astype(np.uint32)


def arc(points: ArrayLike, steps: int = 8, closed: bool = False) -> Float:
    """A smooth curve (M, 3) through points (N, 3), `steps` to a span: a Catmull-Rom spline."""
    p = np.asarray(points, dtype=np.float64)
    q = _with_neighbours(p, closed)
    a, b, c, d = q[:-3, None], q[1:-2, None], q[2:-1, None], q[3:, None]
    t = (np.arange(steps) / steps)[:, None]
    # Through b at t = 0 and c at t = 1, with the slopes (c - a)/2 and (d - b)/2 there.
    cubic = (3 * b + d - a - 3 * c) * t**3
    square = (2 * a - 5 * b + 4 * c - d) * t**2
    curve = 0.5 * (2 * b + (c - a) * t + square + cubic)
    flat = _points(curve)
    if closed:
        return flat
    return np.vstack([flat, p[-1:]])


def _with_neighbours(points: Float, closed: bool) -> Float:
    """Points (N, 3) with one before and one or two after: those of the ring, or of the extended line."""
    if closed:
        return np.concatenate([points[-1:], points, points[:2]])
    before = 2 * points[:1] - points[1:2]
    after = 2 * points[-1:] - points[-2:-1]
    return np.concatenate([before, points, after])


def circle(radius: float, count: int = 32, height: float = 0.0) -> Float:
    """Points (count, 3) of a level circle about the z axis, counter-clockwise, without the first one again."""
    angle = 2 * math.pi * np.arange(count) / count
    x = radius * np.cos(angle)
    y = radius * np.sin(angle)
    return np.stack([x, y, np.full(count, height)], axis=-1)


def sheet(points: Float, thickness: float) -> Mesh:
    """A closed thin sheet of a grid of points (rows, columns, 3), half its thickness on each side of them.

    Its front is the side from which columns run to the right and rows upwards.
    """
    rows, columns = points.shape[:2]
    normals = _points(_grid_normals(points))
    uv = _lengths_along(points).reshape(-1, 2)
    front = _points(points) + thickness / 2 * normals
    faces = shapes.grid(columns, rows)
    sides = double_sided(front, faces, normals, uv, thickness)
    rim = _rim(rows, columns, front, thickness * normals, uv)
    return shapes.merged([sides, rim])


def _grid_normals(points: Float) -> Float:
    """Unit normals (rows, columns, 3) of a grid of points."""
    to_right = np.gradient(points, axis=1)
    upwards = np.gradient(points, axis=0)
    normal = np.cross(to_right, upwards)
    return np.asarray(normal / np.linalg.norm(normal, axis=2, keepdims=True))


def _lengths_along(points: Float) -> Float:
    """Mean lengths (rows, columns, 2) in metres from the first column and from the first row of a grid of points."""
    to_right = np.linalg.norm(np.diff(points, axis=1), axis=2)
    upwards = np.linalg.norm(np.diff(points, axis=0), axis=2)
    u = np.append(0.0, to_right.mean(axis=0).cumsum())
    v = np.append(0.0, upwards.mean(axis=1).cumsum())
    return np.stack(np.meshgrid(u, v), axis=-1)


def _rim(rows: int, columns: int, front: Float, through: Float, uv: Float) -> Mesh:
    """The edge of a sheet: a strip between the border of its front and that of its back."""
    border = _border(rows, columns)
    at = border[:-1]
    following = border[1:]
    back = front - through
    quads = np.stack([front[at], back[at], back[following], front[following]], axis=1)
    down = quads[:, 1] - quads[:, 0]
    onwards = quads[:, 3] - quads[:, 0]
    normal = np.cross(down, onwards)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    corners = np.stack([uv[at], uv[at], uv[following], uv[following]], axis=1)
    faces = _repeated(_QUAD, len(at), 4)
    normals = np.repeat(normal, 4, axis=0)
    return Mesh(_points(quads), faces, normals, corners.reshape(-1, 2))


def _border(rows: int, columns: int) -> NDArray[np.int64]:
    """The vertices of the border of a grid in order: first row, last column, last row, first column."""
    index = np.arange(rows * columns).reshape(rows, columns)
    first_row = index[0]
    last_column = index[1:, -1]
    last_row = index[-1, -2::-1]
    first_column = index[-2::-1, 0]
    return np.concatenate([first_row, last_column, last_row, first_column])


def blade(length: float, width: float, rows: int, droop: float, fold: float) -> Mesh:
    """A leaf from the origin along +y, its upper side up: 8 `rows` triangles, both sides.

    droop : how far its tip hangs below the tangent at its base, as a share of its length.
    fold : how far its edges rise above its midrib, as a share of half its width.
    """
    t = np.linspace(0, 1, rows + 2)
    # The widest place is 40 % along the leaf.
    half = width / 2 * np.sin(math.pi * t**0.76)
    # A parabola downwards, shortened so that the midrib keeps its length.
    y = length * t * (1 - droop**2 / 3 * t**2)
    z = -droop * length * t**2
    midrib = np.stack([np.zeros_like(t), y, z], axis=-1)
    left = np.stack([-half, y, z + fold * half], axis=-1)[1:-1]
    right = left * [-1, 1, 1]
    vertices = np.concatenate([midrib, left, right])
    faces = _blade_faces(rows)
    normals = _mean_normals(vertices, faces)
    uv = vertices[:, :2].copy()
    return double_sided(vertices, faces, normals, uv, _LEAF_THICKNESS)


def _mean_normals(vertices: Float, faces: NDArray[np.uint32]) -> Float:
    """Unit normals (V, 3): means over the faces at a vertex, weighted by their areas."""
    cross = shapes.face_cross(vertices, faces)
    normals = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(normals, faces[:, corner], cross)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return normals


def _blade_faces(rows: int) -> NDArray[np.uint32]:
    """Triangles of a midrib of rows + 2 vertices with `rows` vertices on its left, then on its right."""
    tip = rows + 1
    left = tip + 1
    right = left + rows
    faces = [(0, 1, left), (0, right, 1)]
    for row in range(rows - 1):
        here = row + 1
        after = row + 2
        faces.append((left + row, here, after))
        faces.append((left + row, after, left + row + 1))
        faces.append((here, right + row, right + row + 1))
        faces.append((here, right + row + 1, after))
    faces.append((left + rows - 1, rows, tip))
    faces.append((rows, right + rows - 1, tip))
    return np.array(faces, dtype=np.uint32)


def copies(mesh: Mesh, poses: Float, shift_uv: Float | None = None) -> Mesh:
    """One mesh of copies at poses (N, 4, 4) that may scale evenly; `shift_uv` (N, 2) moves each copy's (u, v)."""
    transposed = poses[:, :3, :3].transpose(0, 2, 1)
    vertices = mesh.vertices @ transposed + poses[:, None, :3, 3]
    normals = np.asarray(mesh.normals) @ transposed
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    if shift_uv is None:
        shift_uv = np.zeros((len(poses), 2))
    uv = np.asarray(mesh.uv) + shift_uv[:, None]
    faces = _repeated(mesh.faces.astype(np.int64), len(poses), len(mesh.vertices))
    return Mesh(_points(vertices), faces, _points(normals), uv.reshape(-1, 2))
