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
    return Solid(
        replace(mesh, vertices=vertices),
        upright,
        (span[0] / size, span[1] / size),
        around,
    )


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
    n = len(outline)
    inner = outline * (1 - bevel / np.linalg.norm(outline, axis=1, keepdims=True))
    rings = [
        (inner, -height / 2),
        (outline, -height / 2 + bevel),
        (outline, height / 2 - bevel),
        (inner, height / 2),
    ]
    if hole > 0:
        angle = np.arctan2(outline[:, 1], outline[:, 0])
        rim = hole * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        rings += [(rim, height / 2), (rim, -height / 2)]
    vertices = np.concatenate([np.column_stack([xy, np.full(n, z)]) for xy, z in rings])
    # Two triangles between neighbours of one ring and of the next; with a hole, the last ring meets the first.
    index = np.arange(len(rings) * n).reshape(len(rings), n)
    following = np.roll(index, -1, axis=1)
    is_open = hole == 0
    pairs = [(a, (a + 1) % len(rings)) for a in range(len(rings) - is_open)]
    faces = [np.stack([index[a], following[a], following[b]], -1) for a, b in pairs]
    faces += [np.stack([index[a], following[b], index[b]], -1) for a, b in pairs]
    if is_open:
        # A fan about the middle of each end.
        low, high = len(vertices), len(vertices) + 1
        vertices = np.vstack([vertices, [[0, 0, -height / 2], [0, 0, height / 2]]])
        faces.append(np.stack([following[0], index[0], np.full(n, low)], -1))
        faces.append(np.stack([index[-1], following[-1], np.full(n, high)], -1))
    return unit(box_mapped(vertices, np.concatenate(faces), 25.0), False)


def polar(radius: Callable[[Float], Float], count: int = 120) -> Float:
    """Outline (N, 2) of a radius that depends on the angle."""
    angle = np.linspace(0, 2 * math.pi, count, endpoint=False)
    return np.asarray(
        radius(angle)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    )


def box_mapped(vertices: Float, faces: NDArray[Any], smooth_deg: float) -> Mesh:
    """A mesh with box-mapped (u, v), and normals smooth between faces that meet at less than `smooth_deg`.

    The normal of a corner is the area-weighted mean over the faces at its vertex that are within this angle of its own.
    """
    cross = shapes.face_cross(vertices, faces)
    unit_cross = _normalized(cross)
    corner_of, mate_of = _corner_pairs(faces)
    face, neighbour = corner_of // 3, mate_of // 3
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
    v, u = np.meshgrid(
        np.linspace(0, 1, len(closed)), np.linspace(0, 1, columns + 1), indexing="ij"
    )
    vertices, faces = closed.reshape(-1, 3), shapes.grid(columns + 1, len(closed))
    cross = shapes.face_cross(vertices, faces)
    has_area = np.linalg.norm(cross, axis=1) > 1e-12  # not so at poles
    faces, cross = faces[has_area], cross[has_area]
    # Vertices at one place, on both sides of the seam, share a normal.
    _, same = np.unique(np.round(vertices, 9), axis=0, return_inverse=True)
    total = np.zeros((same.max() + 1, 3))
    for corner in range(3):
        np.add.at(total, same.ravel()[faces[:, corner]], cross)
    normals = _normalized(total[same.ravel()])
    uv = np.stack([u, v], axis=-1).reshape(-1, 2)
    return unit(Mesh(vertices, faces, normals, uv), False, span, around=True)


def _normalized(vectors: Float) -> Float:
    return np.asarray(
        vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-15)
    )


def double_sided(
    vertices: Float, faces: NDArray[Any], normals: Float, uv: Float, thickness: float
) -> Mesh:
    """A thin sheet that is seen from both sides, the back `thickness` behind the front."""
    back = Mesh(vertices - thickness * normals, faces[:, ::-1], -normals, uv)
    return shapes.merged([Mesh(vertices, faces, normals, uv), back])
