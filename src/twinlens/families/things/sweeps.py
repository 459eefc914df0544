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
    steps = np.linalg.norm(np.diff(centre, axis=1), axis=2)
    length = np.concatenate([np.zeros((len(centre), 1)), steps.cumsum(axis=1)], axis=1)
    tangent = _tangents(centre, closed)
    normal = _frames(centre, tangent, closed)
    binormal = np.cross(tangent, normal)

    angle = np.linspace(0, 2 * math.pi, sides + 1)
    cosine, sine = np.cos(angle)[:, None], np.sin(angle)[:, None]
    # The seam, where the angle is a full turn, has the positions of angle 0 to the last bit.
    cosine[-1], sine[-1] = cosine[0], sine[0]
    outward = cosine * normal[:, :, None] + sine * binormal[:, :, None]
    vertices = centre[:, :, None] + radii[:, :, None, None] * outward
    if closed:
        vertices[:, -1] = vertices[:, 0]
    girth = angle * radii.mean(axis=1)[:, None]
    uv = np.stack(
        np.broadcast_arrays(girth[:, None], length[:, :, None]),
        axis=-1,
    )
    count, rows = centre.shape[:2]
    faces = _repeated(
        shapes.grid(sides + 1, rows).astype(np.int64), count, rows * (sides + 1)
    )
    body = Mesh(
        vertices.reshape(-1, 3), faces, outward.reshape(-1, 3), uv.reshape(-1, 2)
    )
    if closed:
        return body
    start = _ends(vertices[:, 0, :-1], centre[:, 0], -tangent[:, 0])
    end = _ends(vertices[:, -1, -2::-1], centre[:, -1], tangent[:, -1])
    return shapes.merged([body, start, end])


def _tangents(centre: Float, closed: bool) -> Float:
    """Unit tangents (B, N, 3): the mean direction of the steps before and after."""
    step = np.diff(centre, axis=1)
    step /= np.linalg.norm(step, axis=2, keepdims=True)
    first, last = step[:, :1], step[:, -1:]
    if closed:
        first = last = first + last
    total = np.concatenate([first, step[:, 1:] + step[:, :-1], last], axis=1)
    return np.asarray(total / np.linalg.norm(total, axis=2, keepdims=True))


def _frames(centre: Float, tangent: Float, closed: bool) -> Float:
    """Unit normals (B, N, 3) across the tangents, which turn about them as little as possible."""
    axis = np.eye(3)[np.abs(tangent[:, 0]).argmin(axis=1)]
    along = (axis * tangent[:, 0]).sum(axis=1, keepdims=True)
    first = axis - along * tangent[:, 0]
    normal = np.empty_like(tangent)
    normal[:, 0] = first / np.linalg.norm(first, axis=1, keepdims=True)
    for i in range(tangent.shape[1] - 1):
        # Double reflection: in the plane between the two points, then in that between the two tangents.
        between = centre[:, i + 1] - centre[:, i]
        reflected = _reflected(normal[:, i], between)
        reflected_tangent = _reflected(tangent[:, i], between)
        normal[:, i + 1] = _reflected(reflected, tangent[:, i + 1] - reflected_tangent)
    if closed:
        _untwist(normal, tangent)
    return normal


def _reflected(vectors: Float, across: Float) -> Float:
    """Vectors (B, 3) reflected in the planes with normals `across` (B, 3); unchanged where these are 0."""
    square = (across * across).sum(axis=1, keepdims=True)
    share = 2 * (across * vectors).sum(axis=1, keepdims=True)
    return np.asarray(vectors - share / np.where(square > 1e-30, square, 1.0) * across)


def _untwist(normal: Float, tangent: Float) -> None:
    """Spread over the closed paths the angle by which their last frame differs from their first."""
    side = np.cross(tangent[:, 0], normal[:, 0])
    x = (normal[:, -1] * normal[:, 0]).sum(axis=1)
    y = (normal[:, -1] * side).sum(axis=1)
    share = np.linspace(0, 1, normal.shape[1])
    angle = -np.arctan2(y, x)[:, None, None] * share[:, None]
    turned = np.cos(angle) * normal + np.sin(angle) * np.cross(tangent, normal)
    normal[:] = turned


def _ends(ring: Float, centre: Float, normal: Float) -> Mesh:
    """Flat fans over rings (B, sides, 3) that run clockwise as seen along `normal` (B, 3)."""
    count, sides = ring.shape[:2]
    vertices = np.concatenate([ring, centre[:, None]], axis=1)
    index = np.arange(sides)
    fan = np.stack([np.roll(index, -1), index, np.full(sides, sides)], axis=-1)
    faces = _repeated(fan, count, sides + 1)
    normals = np.repeat(normal, sides + 1, axis=0)
    radius = np.linalg.norm(ring - centre[:, None], axis=2, keepdims=True)
    angle = 2 * math.pi * index / sides
    circle = radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    uv = np.concatenate([circle, np.zeros((count, 1, 2))], axis=1)
    return Mesh(vertices.reshape(-1, 3), faces, normals, uv.reshape(-1, 2))


def _repeated(faces: NDArray[np.int64], count: int, stride: int) -> NDArray[np.uint32]:
    """Faces (F, 3) of `count` parts whose vertices follow each other, `stride` a part."""
    starts = stride * np.arange(count)[:, None, None]
    return (faces + starts).reshape(-1, 3).astype(np.uint32)


def arc(points: ArrayLike, steps: int = 8, closed: bool = False) -> Float:
    """A smooth curve (M, 3) through points (N, 3), `steps` to a span: a Catmull-Rom spline."""
    p = np.asarray(points, dtype=np.float64)
    ring = [p[-1:], p, p[:2]]
    line = [2 * p[:1] - p[1:2], p, 2 * p[-1:] - p[-2:-1]]
    q = np.concatenate(ring if closed else line)
    a, b, c, d = q[:-3, None], q[1:-2, None], q[2:-1, None], q[3:, None]
    t = (np.arange(steps) / steps)[:, None]
    cubic = (3 * b + d - a - 3 * c) * t**3
    square = (2 * a - 5 * b + 4 * c - d) * t**2
    curve = 0.5 * (2 * b + (c - a) * t + square + cubic)
    flat = curve.reshape(-1, 3)
    return flat if closed else np.vstack([flat, p[-1:]])


def circle(radius: float, count: int = 32, height: float = 0.0) -> Float:
    """Points (count, 3) of a level circle about the z axis, counter-clockwise, without the first one again."""
    angle = 2 * math.pi * np.arange(count) / count
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    return np.stack([x, y, np.full(count, height)], axis=-1)


def sheet(points: Float, thickness: float) -> Mesh:
    """A closed thin sheet of a grid of points (rows, columns, 3), half its thickness on each side of them.

    Its front is the side from which columns run to the right and rows upwards.
    """
    rows, columns = points.shape[:2]
    normals = _grid_normals(points)
    across = np.linalg.norm(np.diff(points, axis=1), axis=2).mean(axis=0)
    along = np.linalg.norm(np.diff(points, axis=0), axis=2).mean(axis=1)
    u, v = np.append(0.0, across.cumsum()), np.append(0.0, along.cumsum())
    uv = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    flat = normals.reshape(-1, 3)
    front = points.reshape(-1, 3) + thickness / 2 * flat
    sides = double_sided(front, shapes.grid(columns, rows), flat, uv, thickness)
    return shapes.merged([sides, _rim(rows, columns, front, thickness * flat, uv)])


def _grid_normals(points: Float) -> Float:
    normal = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
    return np.asarray(normal / np.linalg.norm(normal, axis=2, keepdims=True))


def _rim(rows: int, columns: int, front: Float, through: Float, uv: Float) -> Mesh:
    """The edge of a sheet: a strip between the border of its front and that of its back."""
    index = np.arange(rows * columns).reshape(rows, columns)
    border = np.concatenate(
        [index[0], index[1:, -1], index[-1, -2::-1], index[-2::-1, 0]]
    )
    at, following = border[:-1], border[1:]
    back = front - through
    quads = np.stack([front[at], back[at], back[following], front[following]], axis=1)
    normal = np.cross(quads[:, 1] - quads[:, 0], quads[:, 3] - quads[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    corners = np.stack([uv[at], uv[at], uv[following], uv[following]], axis=1)
    quad = np.array([[0, 1, 2], [0, 2, 3]])
    faces = _repeated(quad, len(at), 4)
    return Mesh(
        quads.reshape(-1, 3),
        faces,
        np.repeat(normal, 4, axis=0),
        corners.reshape(-1, 2),
    )


def blade(length: float, width: float, rows: int, droop: float, fold: float) -> Mesh:
    """A leaf from the origin along +y, its upper side up: 8 `rows` triangles, both sides.

    droop : how far its tip hangs below the tangent at its base, as a share of its length.
    fold : how far its edges rise above its midrib, as a share of half its width.
    """
    t = np.linspace(0, 1, rows + 2)
    # The widest place is 40 % along the leaf.
    half = width / 2 * np.sin(math.pi * t**0.76)
    y, z = length * t * (1 - droop**2 / 3 * t**2), -droop * length * t**2
    left = np.stack([-half, y, z + fold * half], axis=-1)[1:-1]
    right = left * [-1, 1, 1]
    midrib = np.stack([np.zeros_like(t), y, z], axis=-1)
    vertices = np.concatenate([midrib, left, right])
    faces = _blade_faces(rows)
    # Vertices at the two ends belong to both halves; normals are their mean.
    cross = shapes.face_cross(vertices, faces)
    normals = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(normals, faces[:, corner], cross)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return double_sided(vertices, faces, normals, vertices[:, :2].copy(), 2e-4)


def _blade_faces(rows: int) -> NDArray[np.uint32]:
    """Triangles of a midrib of rows + 2 vertices with `rows` vertices on its left, then on its right."""
    left, right, tip = rows + 2, 2 * rows + 2, rows + 1
    faces = [(0, 1, left), (0, right, 1)]
    for row in range(rows - 1):
        a, b = row + 1, row + 2
        faces += [(left + row, a, b), (left + row, b, left + row + 1)]
        faces += [(a, right + row, right + row + 1), (a, right + row + 1, b)]
    faces += [(left + rows - 1, rows, tip), (rows, right + rows - 1, tip)]
    return np.array(faces, dtype=np.uint32)


def copies(mesh: Mesh, poses: Float, shift_uv: Float | None = None) -> Mesh:
    """One mesh of copies at poses (N, 4, 4) that may scale evenly; `shift_uv` (N, 2) moves each copy's (u, v)."""
    linear = poses[:, :3, :3]
    vertices = mesh.vertices @ linear.transpose(0, 2, 1) + poses[:, None, :3, 3]
    normals = np.asarray(mesh.normals) @ linear.transpose(0, 2, 1)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    shifts = np.zeros((len(poses), 2)) if shift_uv is None else shift_uv
    uv = np.asarray(mesh.uv) + shifts[:, None]
    faces = _repeated(mesh.faces.astype(np.int64), len(poses), len(mesh.vertices))
    return Mesh(
        vertices.reshape(-1, 3), faces, normals.reshape(-1, 3), uv.reshape(-1, 2)
    )
