"""Meshes from a few numbers: trimesh's, and rounded boxes, lathes, tubes, height fields and bent sheets.

Every function returns a `Mesh` in metres around the origin, z up, with (u, v). Smooth surfaces have vertex normals;
boxes and cones of few sides are flat.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.geometry import Float, transform_points
from twinlens.scenes.scene import Bitmap, Mesh, Plugin

Faces = NDArray[np.uint32]
Place = Callable[[Float, int], tuple[Float, Float]]
"""Points and normals (N, 3) from points (N, 3) on a side of a cube, and the axis that is normal to the side."""

_ROUND_FROM = 16


def box(extents: Float, tile: float | None = None) -> Mesh:
    """A box; (u, v) span [0, 1]^2 on each face, or repeat every `tile` metres."""
    u, v = np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]]).T
    faces = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32)
    is_axis = np.eye(3, dtype=bool)

    def place(cube: Float, axis: int) -> tuple[Float, Float]:
        return cube / 2 * extents, np.where(is_axis[axis], cube, 0)

    return _six_sides(u, v, faces, place, extents, tile)


def rounded_box(
    extents: Float, radius: float, subdivisions: int = 6, tile: float | None = None
) -> Mesh:
    """A box with edges and corners rounded by `radius` metres (<= half the shortest side); (u, v) as for `box`."""
    # A side from -2 to 2: the flat part is -1 to 1, the rest becomes the rounded edges.
    steps = np.linspace(0, 1, subdivisions + 1)
    line = np.concatenate([-1 - np.linspace(1, 0, subdivisions + 1), 1 + steps])
    v, u = (values.ravel() for values in np.meshgrid(line, line, indexing="ij"))

    def place(cube: Float, axis: int) -> tuple[Float, Float]:
        inner = np.clip(cube, -1, 1)
        away = np.tan((cube - inner) * (math.pi / 4))  # even steps of angle
        normals = away / np.linalg.norm(away, axis=-1, keepdims=True)
        return inner * (np.asarray(extents) / 2 - radius) + radius * normals, normals

    return _six_sides(u, v, grid(len(line), len(line)), place, extents, tile)


def _six_sides(
    u: Float, v: Float, faces: Faces, place: Place, extents: Float, tile: float | None
) -> Mesh:
    """A box. `faces` and the vertices u, v (N,) are one side of a cube; `place` moves vertices from cube to box."""
    sides: list[tuple[Float, Faces, Float, Float]] = []
    for axis, a, b in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):  # right-handed
        across = [i for i in range(3) if i != axis]  # v is along z on vertical sides
        size = np.asarray(extents)[across]
        for end in (-u.max(), u.max()):
            cube = np.empty((len(u), 3))
            cube[:, axis], cube[:, a], cube[:, b] = end, u, v
            points, normals = place(cube, axis)
            uv = (points[:, across] + size / 2) / (size if tile is None else tile)
            numbered = faces + np.uint32(len(sides) * len(u))
            outward = numbered if end > 0 else numbered[:, ::-1]
            sides.append((points, outward, normals, uv))
    vertices, faces, normals, uv = (
        np.concatenate(arrays) for arrays in zip(*sides, strict=True)
    )
    return Mesh(vertices, faces, normals, uv)


def grid(columns: int, rows: int) -> Faces:
    """Triangles (F, 3) of a grid of vertices numbered row by row, counter-clockwise with x right and y up."""
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    # Each quadrilateral a b c d is cut along its diagonal a c.
    first, second = np.stack([a, b, c], -1), np.stack([a, c, d], -1)
    quads = np.stack([first, second], axis=-2)
    return quads.reshape(-1, 3).astype(np.uint32)


def lathe(
    profile: Float, segments: int = 96, smooth: bool = True, samples: int = 12
) -> Mesh:
    """The surface of revolution of a `profile` of (radius, height) points, from the bottom up, about the z axis.

    `smooth` interpolates by a Catmull-Rom curve, `samples` steps a span; a point given twice is a sharp corner. u is
    the angle, v the length along the profile. For a vessel, go up the outside and down the inside.
    """
    points = np.asarray(profile, dtype=np.float64)
    corners = np.flatnonzero((np.diff(points, axis=0) == 0).all(axis=1)) + 1
    pieces = [piece for piece in np.split(points, corners) if len(piece) > 1]
    curves = [
        _catmull_rom(piece, samples) if smooth and len(piece) > 2 else piece
        for piece in pieces
    ]
    lengths = np.cumsum([0.0] + [_arc_length(curve)[-1] for curve in curves])
    angle = np.linspace(0, 2 * math.pi, segments + 1)
    cos, sin = np.cos(angle), np.sin(angle)
    parts = []
    shares = lengths / lengths[-1]
    for curve, start, end in zip(curves, shares[:-1], shares[1:], strict=True):
        tangent, length = _tangents(curve), _arc_length(curve)
        radius, height = np.maximum(curve[:, :1], 0.0), curve[:, 1:]
        vertices = _stacked(radius * cos, radius * sin, height)
        # The tangent (dr, dz) of the profile, turned by a right angle: (dz, -dr) points outwards.
        outwards, upwards = tangent[:, 1:], -tangent[:, :1]
        normals = _stacked(outwards * cos, outwards * sin, upwards)
        v = start + (end - start) * length / length[-1]
        parts.append(
            _sheet(vertices, normals, _stacked(angle / (2 * math.pi), v[:, None]))
        )
    return merged(parts)


def _stacked(*columns: Float) -> Float:
    """Arrays that broadcast together as the last axis of one array."""
    return np.stack(np.broadcast_arrays(*columns), axis=-1)


def cone(radius: float, height: float, sections: int = 64) -> Mesh:
    """A cone on the plane z = 0, round from 16 sections on, a flat-sided pyramid below."""
    if sections < _ROUND_FROM:
        return creation("cone", radius=radius, height=height, sections=sections)
    return lathe(
        np.array([[0, 0], [radius, 0], [radius, 0], [0, height]]),
        sections,
        smooth=False,
    )


def merged(parts: list[Mesh]) -> Mesh:
    """Several meshes as one. Normals, (u, v) and surfaces are kept if all have them; missing attributes are 0."""
    starts = np.cumsum([0] + [len(part.vertices) for part in parts])
    numbered = zip(parts, starts, strict=False)
    faces = np.concatenate([part.faces + np.uint32(start) for part, start in numbered])
    arrays: dict[str, Any] = {}
    for name in ("vertices", "normals", "uv", "surface"):
        values = [getattr(part, name) for part in parts]
        is_partial = any(array is None for array in values)
        arrays[name] = None if is_partial else np.concatenate(values)
    return Mesh(faces=faces, attributes=_merged_attributes(parts), **arrays)


def _merged_attributes(parts: list[Mesh]) -> dict[str, Float]:
    widths: dict[str, int] = {}
    for part in parts:
        widths |= {name: array.shape[1] for name, array in part.attributes.items()}
    merged = {}
    for name, width in widths.items():
        missing = [np.zeros((len(part.vertices), width)) for part in parts]
        arrays = [
            part.attributes.get(name, zeros)
            for part, zeros in zip(parts, missing, strict=True)
        ]
        merged[name] = np.concatenate(arrays)
    return merged


def transformed(mesh: Mesh, b_from_a: Float) -> Mesh:
    """A mesh transformed by an affine 4x4; normals by its inverse transpose. Normals of length 0 stay so."""
    normals = mesh.normals
    if normals is not None:
        normals = normals @ np.linalg.inv(b_from_a[:3, :3])
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        normals = normals / np.where(length > 0, length, 1.0)
    return replace(
        mesh, vertices=transform_points(b_from_a, mesh.vertices), normals=normals
    )


def flattened(mesh: Mesh, b_from_a: Float) -> Mesh:
    """A mesh transformed by an affine 4x4 that makes it flat; triangles without area and normals are left out."""
    vertices = transform_points(b_from_a, mesh.vertices)
    area = np.linalg.norm(face_cross(vertices, mesh.faces), axis=1)
    size = np.ptp(vertices, axis=0).max()
    shown = area > 1e-12 * size**2
    surface = None if mesh.surface is None else mesh.surface[shown]
    return replace(
        mesh, vertices=vertices, faces=mesh.faces[shown], normals=None, surface=surface
    )


def tessellated(shape: Plugin) -> Mesh:
    """Triangles of an analytic shape. Their vertices are on it, some of them at the ends of its own axes."""
    kind, radius, pose = shape["type"], float(shape.get("radius", 1.0)), np.eye(4)
    if kind == "cube":
        made = box(np.full(3, 2.0))
    elif kind == "rectangle":
        corners = np.array([[-1.0, -1, 0], [1, -1, 0], [-1, 1, 0], [1, 1, 0]])
        made = Mesh(corners, grid(2, 2))
    elif kind == "disk":
        made = lathe(np.array([[1.0, 0], [0, 0]]), 128, smooth=False)
    elif kind == "cylinder":
        made = lathe(np.array([[radius, 0], [radius, 1]]), 128, smooth=False)
        start = np.asarray(shape.get("p0", (0, 0, 0)), dtype=np.float64)
        along = shape.get("p1", (0, 0, 1)) - start
        # Any direction at right angles to the axis: the second right singular vector spans its null space.
        across = np.linalg.svd(along[None])[2][1]
        third = np.cross(along, across) / np.linalg.norm(along)
        pose[:3] = np.column_stack([across, third, along, start])
    else:
        angle = np.linspace(-math.pi / 2, math.pi / 2, 65)
        half_circle = radius * np.column_stack([np.cos(angle), np.sin(angle)])
        made = lathe(half_circle, 128, smooth=False)
        pose[:3, 3] = shape.get("center", (0, 0, 0))
    return transformed(made, np.asarray(shape.get("to_world", np.eye(4))) @ pose)


def tube(
    points: Float,
    radius: Float,
    sides: int = 16,
    smooth: bool = True,
    closed: bool = False,
) -> Mesh:
    """A round pipe along `points` (N, 3); `radius` is one number or one per point. u is the angle, v the length.

    Source: Wang et al., Computation of Rotation Minimizing Frames, ACM TOG 27(1), 2008 (first-order form).
    """
    path = np.column_stack([points, np.broadcast_to(radius, len(points))])
    if closed:
        path = np.vstack([path, path[:1]])
    path = _catmull_rom(path, 8, closed) if smooth else path
    centre, radii = path[:, :3], np.maximum(path[:, 3], 1e-9)
    tangent = _tangents(centre)
    if closed:
        across_seam = tangent[0] + tangent[-1]
        tangent[[0, -1]] = across_seam / np.linalg.norm(across_seam)
    normal = _normals_without_twist(tangent)
    binormal = np.cross(tangent, normal)
    angle = np.linspace(0, 2 * math.pi, sides + 1)[None, :, None]
    around = np.cos(angle) * normal[:, None] + np.sin(angle) * binormal[:, None]
    length = _arc_length(centre)
    uv = _stacked(angle[..., 0] / (2 * math.pi), (length / length[-1])[:, None])
    return _sheet(centre[:, None] + radii[:, None, None] * around, around, uv)


def _normals_without_twist(tangents: Float) -> Float:
    """A unit normal (N, 3) of each unit tangent (N, 3): the last one without its part along the new tangent.

    Where the path turns by a right angle towards the last normal, nothing is left of that; the rotation from the last
    tangent to the new one takes it to the last tangent, reversed.
    """
    normals, last = [], np.eye(3)[np.argmin(np.abs(tangents[0]))]
    before = tangents[0]
    for tangent in tangents:
        along = last @ tangent
        across = last - along * tangent
        if np.linalg.norm(across) < 1e-6:
            across = -along * before
            across = across - (across @ tangent) * tangent
        last = across / np.linalg.norm(across)
        normals.append(last)
        before = tangent
    return np.array(normals)


def height_field(
    extents: Float,
    height: Bitmap,
    amplitude: float = 1.0,
    grid: list[int] | None = None,
) -> Mesh:
    """A smooth sheet of `extents` = (x, y) metres with vertices at z = amplitude * height, rows from +y to -y.

    `grid` is the number of vertices along x and y, by default one per texel up to 257.
    """
    heights = height.pixels if height.pixels.ndim == 2 else height.pixels.mean(axis=2)
    rows, columns = heights.shape
    nx, ny = grid or (min(columns, 257), min(rows, 257))
    chosen_rows = np.linspace(0, rows - 1, ny).astype(int)
    chosen_columns = np.linspace(0, columns - 1, nx).astype(int)
    picked = heights[chosen_rows][:, chosen_columns]
    x = np.linspace(-0.5, 0.5, nx) * extents[0]
    y = np.linspace(-0.5, 0.5, ny) * extents[1]
    z = (amplitude * picked)[::-1].astype(np.float64)
    # The surface z = f(x, y) has the normal (-df/dx, -df/dy, 1).
    slope_y, slope_x = np.gradient(z, y, x)
    normals = np.stack([-slope_x, -slope_y, np.ones_like(z)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    X, Y = np.meshgrid(x, y)
    uv = np.stack([X / extents[0] + 0.5, Y / extents[1] + 0.5], axis=-1)
    return _sheet(np.stack([X, Y, z], axis=-1), normals, uv)


def bent_sheet(extents: Float, angle_deg: float, segments: int = 64) -> Mesh:
    """A rectangle of `extents` = (x, y) metres bent about the y axis by `angle_deg` in total, of constant length."""
    angle = math.radians(angle_deg)
    # An arc of the length extents[0] and the angle `angle`, by its arc length s from -1/2 to 1/2, with its top at the
    # origin and its centre at (0, -radius).
    s = np.linspace(-0.5, 0.5, segments + 1)
    radius = extents[0] / angle
    x, z = radius * np.sin(s * angle), radius * (np.cos(s * angle) - 1)
    y = np.array([-0.5, 0.5]) * extents[1]
    vertices = _stacked(x, y[:, None], z)
    normals = _stacked(np.sin(s * angle), np.zeros((2, 1)), np.cos(s * angle))
    uv = _stacked(s + 0.5, np.array([[0.0], [1.0]]))
    return _sheet(vertices, normals, uv)


def creation(name: str, **parameters: Any) -> Mesh:
    """A mesh of a function of trimesh.creation; (u, v) is longitude and height, edges over 30 degrees are sharp."""
    import trimesh

    return from_trimesh(getattr(trimesh.creation, name)(**parameters))


def from_trimesh(
    made: Any, crease_deg: float = 30.0, attributes: Mapping[str, Float] | None = None
) -> Mesh:
    """A trimesh mesh, smooth where faces meet at less than `crease_deg`; (u, v) its own, else longitude and height.

    `attributes` are values of its vertices, (V, N) each.
    """
    import trimesh

    values = dict(attributes or {})
    normals = None
    if crease_deg > 0:
        whole = made
        made = trimesh.graph.smooth_shade(whole, angle=math.radians(crease_deg))
        sources = _sources(whole, made)
        values = {name: array[sources] for name, array in values.items()}
        normals = np.array(made.vertex_normals, dtype=np.float64)
    vertices = np.array(made.vertices, dtype=np.float64)
    faces = np.array(made.faces, dtype=np.uint32)
    uv = getattr(made.visual, "uv", None)
    if uv is None or len(uv) != len(vertices):
        return with_longitude(Mesh(vertices, faces, normals, attributes=values))
    uv = np.array(uv, dtype=np.float64)
    return Mesh(vertices, faces, normals, uv, attributes=values)


def _sources(whole: Any, smooth: Any) -> NDArray[np.int64]:
    """The vertex of `whole` that each vertex of the mesh of `trimesh.graph.smooth_shade` is a copy of, (V,)."""
    components = smooth.metadata.get("original_components")
    if components is None:  # nothing was split
        return np.arange(len(smooth.vertices))
    corners = whole.faces[np.concatenate(components)]
    sources = np.zeros(len(smooth.vertices), dtype=np.int64)
    sources[smooth.faces.ravel()] = corners.ravel()
    return sources


def with_longitude(mesh: Mesh) -> Mesh:
    """A mesh with longitude and height as (u, v).

    Its triangles share no vertices, so that none crosses the seam of the longitude.
    """
    faces = mesh.faces
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    corner = mesh.vertices[faces].reshape(-1, 3)
    away = corner - (low + high) / 2
    u = np.arctan2(away[:, 1], away[:, 0]) / (2 * math.pi) % 1.0
    v = (corner[:, 2] - low[2]) / max(high[2] - low[2], 1e-12)
    triangles = u.reshape(-1, 3)
    crossing = triangles.max(axis=1, keepdims=True) - triangles > 0.5
    # Where a triangle crosses the seam, u goes on beyond 1; textures repeat.
    u = (triangles + crossing).reshape(-1)
    unrolled = np.arange(len(corner), dtype=np.uint32).reshape(-1, 3)
    normals = None if mesh.normals is None else mesh.normals[faces].reshape(-1, 3)
    attributes = {
        name: values[faces.ravel()] for name, values in mesh.attributes.items()
    }
    return replace(
        mesh,
        vertices=corner,
        faces=unrolled,
        normals=normals,
        uv=np.column_stack([u, v]),
        attributes=attributes,
    )


def face_cross(vertices: Float, faces: NDArray[Any]) -> Float:
    """Face normals (F, 3), twice as long as the triangles' areas."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return np.asarray(np.cross(b - a, c - a))


def _sheet(vertices: Float, normals: Float, uv: Float) -> Mesh:
    """A grid of vertices (rows, columns, 3) as a Mesh, without degenerate triangles at poles."""
    rows, columns = vertices.shape[:2]
    points, faces = vertices.reshape(-1, 3), grid(columns, rows)
    area = np.linalg.norm(face_cross(points, faces), axis=1)
    size = np.ptp(points, axis=0).max()
    return Mesh(
        points, faces[area > 1e-12 * size**2], normals.reshape(-1, 3), uv.reshape(-1, 2)
    )


def _arc_length(curve: Float) -> Float:
    """The length (N,) along a curve up to each of its points."""
    steps = np.linalg.norm(np.diff(curve, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _tangents(curve: Float) -> Float:
    """Unit tangents (N, n) of a curve of distinct points: the mean direction of the steps before and after."""
    steps = np.diff(curve, axis=0)
    steps /= np.linalg.norm(steps, axis=1, keepdims=True)
    mean = np.concatenate([steps[:1], steps[1:] + steps[:-1], steps[-1:]])
    length = np.linalg.norm(mean, axis=1, keepdims=True)
    # Where the curve turns back, the two steps cancel: the step before is taken.
    before = np.concatenate([steps[:1], steps])
    return np.where(length > 1e-9, mean / np.maximum(length, 1e-9), before)


def _catmull_rom(points: Float, samples: int, closed: bool = False) -> Float:
    """A curve through all points (N, n), `samples` steps per span. Source: Catmull and Rom 1974."""
    before, after = points[-2], points[1]
    if not closed:  # mirror the ends
        before, after = 2 * points[0] - points[1], 2 * points[-1] - points[-2]
    p = np.vstack([before, points, after])
    t = (np.arange(samples) / samples)[None, :, None]
    # The cubic from b (t = 0) to c (t = 1) with the tangents (c - a) / 2 and (d - b) / 2 there, of four points in a
    # row.
    a, b, c, d = (p[i : len(p) - 3 + i, None] for i in range(4))
    spans = 0.5 * (
        2 * b
        + (c - a) * t
        + (2 * a - 5 * b + 4 * c - d) * t**2
        + (3 * b - 3 * c + d - a) * t**3
    )
    return np.vstack([spans.reshape(-1, points.shape[1]), points[-1:]])
