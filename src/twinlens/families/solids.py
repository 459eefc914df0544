"""Closed bodies of extent 1 m, z up: meshes with normals and texture coordinates, from profiles, outlines and grids.

Every body is watertight once vertices at equal positions are merged, so volumes and centres of mass are defined.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull

from twinlens.geometry import Float
from twinlens.scenes import shapes
from twinlens.scenes.scene import Mesh


@dataclass(frozen=True, eq=False)
class Solid:
    """A body of largest extent 1, centred at the origin.

    `upright` bodies stand on their lowest face; others may rest on any side. `span` is the length of surface, in units
    of the body's extent, that u and v in [0, 1] cover. `around`: u closes on itself, so patterns repeat a whole number
    of times.
    """

    mesh: Mesh
    upright: bool
    span: tuple[float, float] = (1.0, 1.0)
    around: bool = False


def unit(
    mesh: Mesh,
    upright: bool,
    span: tuple[float, float] = (1.0, 1.0),
    around: bool = False,
) -> Solid:
    """A mesh scaled to extent 1 and centred."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    size = float((high - low).max())
    vertices = (mesh.vertices - (low + high) / 2) / size
    scaled_span = span[0] / size, span[1] / size
    return Solid(replace(mesh, vertices=vertices), upright, scaled_span, around)


def lathed(profile: ArrayLike, upright: bool = True, smooth: bool = True) -> Solid:
    """A surface of revolution of (radius, height) points, from the axis at the bottom back to the axis."""
    points = np.asarray(profile, dtype=np.float64)
    mesh = shapes.lathe(points, 56, smooth, samples=5)
    length = float(np.hypot(*np.diff(points, axis=0).T).sum())
    girth = 2 * math.pi * float(points[:, 0].max()) * 0.8
    return unit(mesh, upright, (girth, length), around=True)


def hard_edged(profile: ArrayLike) -> Float:
    """A profile (N, 2) with its inner points doubled: `shapes.lathe` makes a hard edge at each of them."""
    points = np.asarray(profile, dtype=np.float64)
    return np.repeat(points, [1, *[2] * (len(points) - 2), 1], axis=0)


def hull(points: Float) -> Solid:
    """The convex hull of points (N, 3), with flat sides."""
    convex = ConvexHull(points)
    faces = convex.simplices.copy()
    outward = convex.equations[:, :3]
    inward = (shapes.face_cross(points, faces) * outward).sum(axis=1) < 0
    faces[inward] = faces[inward][:, ::-1]
    return unit(box_mapped(points, faces, 0.0), False)


def extruded(
    outline: Float, height: float, hole: float = 0.0, bevel: float = 0.03
) -> Solid:
    """A prism with bevelled edges over an outline (N, 2), star-shaped about the origin; `hole` is a bore's radius."""
    radius = np.linalg.norm(outline, axis=1, keepdims=True)
    inner = outline * (1 - bevel / radius)
    rings = [
        (inner, -height / 2),
        (outline, -height / 2 + bevel),
        (outline, height / 2 - bevel),
        (inner, height / 2),
    ]
    if hole > 0:
        rim = hole * _unit_circle(np.arctan2(outline[:, 1], outline[:, 0]))
        rings += [(rim, height / 2), (rim, -height / 2)]
    points = [np.column_stack([xy, np.full(len(xy), z)]) for xy, z in rings]
    vertices = np.concatenate(points)
    index = np.arange(len(vertices)).reshape(len(rings), -1)
    faces = _between_rings(index, is_bored=hole > 0)
    if hole == 0:
        low, high = len(vertices), len(vertices) + 1
        vertices = np.vstack([vertices, [[0, 0, -height / 2], [0, 0, height / 2]]])
        faces += [_fan(index[0], low)[:, [1, 0, 2]], _fan(index[-1], high)]
    return unit(box_mapped(vertices, np.concatenate(faces), 25.0), False)


def _between_rings(index: NDArray[Any], is_bored: bool) -> list[NDArray[Any]]:
    """Two triangles between neighbours of one ring and of the next, of vertices `index` (rings, N).

    The last ring of a bored body meets the first.
    """
    count = len(index)
    following = np.roll(index, -1, axis=1)
    lower = range(count if is_bored else count - 1)
    right, left = [], []
    for a in lower:
        b = (a + 1) % count
        right.append(np.stack([index[a], following[a], following[b]], -1))
        left.append(np.stack([index[a], following[b], index[b]], -1))
    return [*right, *left]


def _fan(ring: NDArray[Any], middle: int) -> NDArray[Any]:
    """Triangles (N, 3) between the sides of a ring (N,) and the vertex `middle`, counter-clockwise as the ring is."""
    return np.stack([ring, np.roll(ring, -1), np.full(len(ring), middle)], -1)


def _unit_circle(angle: Float) -> Float:
    """Points (N, 2) of the unit circle."""
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def polar(radius: Callable[[Float], Float], count: int = 120) -> Float:
    """Outline (N, 2) of a radius that depends on the angle."""
    angle = np.linspace(0, 2 * math.pi, count, endpoint=False)
    return np.asarray(radius(angle)[:, None] * _unit_circle(angle))


def box_mapped(vertices: Float, faces: NDArray[Any], smooth_deg: float) -> Mesh:
    """A mesh with box-mapped (u, v), and normals smooth between faces that meet at less than `smooth_deg`.

    The normal of a corner is the area-weighted mean over the faces at its vertex that are within this angle of its own.
    """
    cross = shapes.face_cross(vertices, faces)
    unit_cross = _normalized(cross)
    corner_of, mate_of = _corner_pairs(faces)
    face, neighbour = corner_of // 3, mate_of // 3
    # Faces that meet at a small angle are one smooth surface; each face meets itself at 0.
    cosine = np.einsum("nc,nc->n", unit_cross[face], unit_cross[neighbour])
    alike = cosine > math.cos(math.radians(max(smooth_deg, 0.1)))
    total = np.zeros((np.size(faces), 3))
    np.add.at(total, corner_of[alike], cross[neighbour[alike]])

    corner = vertices[faces].reshape(-1, 3)
    # (u, v) are the two coordinates across the axis that the face looks along most.
    main_axis = np.abs(np.repeat(unit_cross, 3, axis=0)).argmax(axis=1)
    across = np.array([(1, 2), (0, 2), (0, 1)])[main_axis]
    uv = np.take_along_axis(corner, across, axis=1)
    unrolled = np.arange(len(corner), dtype=np.uint32).reshape(-1, 3)
    return Mesh(corner, unrolled, _normalized(total), uv)


def _corner_pairs(faces: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """All ordered pairs of triangle corners at the same vertex, each corner with itself too; 3 F corners in order."""
    vertex = np.asarray(faces).reshape(-1)
    order = np.argsort(vertex, kind="stable")  # corners, vertex by vertex
    _, start, valence = np.unique(vertex[order], return_index=True, return_counts=True)
    mates = np.repeat(valence, valence)
    left = np.repeat(np.arange(len(vertex)), mates)
    first_pair = np.cumsum(mates) - mates
    right = np.arange(len(left)) - np.repeat(first_pair, mates)
    right += np.repeat(np.repeat(start, valence), mates)
    return order[left], order[right]


def closed_grid(
    points: Float, span: tuple[float, float], wrap_v: bool = False
) -> Solid:
    """A body from a grid (rows, columns, 3) of wrapping columns; rows end at poles or, with `wrap_v`, wrap too."""
    columns = points.shape[1]
    closed = np.concatenate([points, points[:, :1]], axis=1)
    if wrap_v:
        closed = np.concatenate([closed, closed[:1]], axis=0)
    vertices = closed.reshape(-1, 3)
    faces = shapes.grid(columns + 1, len(closed))
    cross = shapes.face_cross(vertices, faces)
    has_area = np.linalg.norm(cross, axis=1) > 1e-12  # not so at poles
    faces = faces[has_area]
    normals = _shared_normals(vertices, faces, cross[has_area])
    u = np.linspace(0, 1, columns + 1)
    v = np.linspace(0, 1, len(closed))
    uv = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    return unit(Mesh(vertices, faces, normals, uv), False, span, around=True)


def _shared_normals(vertices: Float, faces: NDArray[Any], cross: Float) -> Float:
    """Normals (V, 3): means over the faces at a place. Vertices there, on both sides of the seam, share one."""
    _, place = np.unique(np.round(vertices, 9), axis=0, return_inverse=True)
    place = place.ravel()
    total = np.zeros((place.max() + 1, 3))
    for corner in range(3):
        np.add.at(total, place[faces[:, corner]], cross)
    return _normalized(total[place])


def _normalized(vectors: Float) -> Float:
    """Vectors (N, 3) of length 1; those of length 0 stay so."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors / np.maximum(length, 1e-15))


def double_sided(
    vertices: Float, faces: NDArray[Any], normals: Float, uv: Float, thickness: float
) -> Mesh:
    """A thin sheet that is seen from both sides, the back `thickness` behind the front."""
    back = Mesh(vertices - thickness * normals, faces[:, ::-1], -normals, uv)
    return shapes.merged([Mesh(vertices, faces, normals, uv), back])
