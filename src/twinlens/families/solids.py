"""Closed bodies of about one metre, z up: meshes with normals and texture coordinates, and how they like to stand.

Every body is watertight once its equal vertices are joined, so that volumes and centres of mass mean something.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.geometry import Float
from twinlens.scenes import shapes
from twinlens.scenes.scene import Mesh

Rng = np.random.Generator
Indices = NDArray[Any]


@dataclass(frozen=True, eq=False)
class Solid:
    """A body of largest extent 1 around the origin.

    `upright`: it stands on its lowest face as it is; otherwise it may come to rest on any side. `span` is the length of
    surface, in its own units, that u and v in [0, 1] run over; `around`: u closes on itself, so patterns repeat a whole
    number of times.
    """

    kind: str
    mesh: Mesh
    upright: bool
    span: tuple[float, float] = (1.0, 1.0)
    around: bool = False


def unit(kind: str, mesh: Mesh, upright: bool, span: tuple[float, float] = (1.0, 1.0), around: bool = False) -> Solid:
    """A mesh scaled to extent 1 and centred."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    size = float((high - low).max())
    vertices = (mesh.vertices - (low + high) / 2) / size
    return Solid(
        kind, Mesh(vertices, mesh.faces, mesh.normals, mesh.uv), upright, (span[0] / size, span[1] / size), around
    )


def turned(kind: str, profile: Float, upright: bool = True, smooth: bool = True, segments: int = 56) -> Solid:
    """A surface of revolution from (radius, height) points, from the axis at the bottom back to the axis."""
    mesh = shapes.lathe(profile, segments, smooth, samples=5)
    length = float(np.hypot(*np.diff(profile, axis=0).T).sum())
    return unit(kind, mesh, upright, (2 * math.pi * float(profile[:, 0].max()) * 0.8, length), around=True)


def box_mapped(vertices: Float, faces: Indices, smooth_deg: float) -> Mesh:
    """Texture coordinates from the two coordinates across each triangle's main direction, in the body's own units.

    Smooth where faces that share a vertex meet at less than `smooth_deg`.
    """
    cross = face_cross(vertices, faces)
    unit_cross = cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-15)
    normals = _creased(vertices, np.asarray(faces), cross, math.radians(max(smooth_deg, 0.1)))
    corner = vertices[faces].reshape(-1, 3)
    main = np.abs(np.repeat(unit_cross, 3, axis=0)).argmax(axis=1)
    uv = np.take_along_axis(corner, np.array([(1, 2), (0, 2), (0, 1)])[main], axis=1)
    return Mesh(corner, np.arange(len(corner), dtype=np.uint32).reshape(-1, 3), normals, uv)


def _creased(vertices: Float, faces: Indices, cross: Float, angle: float) -> Float:
    """Normals (3F, 3) of the triangles' corners: the sum of the faces (area-weighted) around a vertex that lie within
    `angle` of the corner's own."""
    corner = faces.reshape(-1)
    order = np.argsort(corner, kind="stable")
    start, valence = np.unique(corner[order], return_index=True, return_counts=True)[1:]
    mates = np.repeat(valence, valence)
    left = np.repeat(np.arange(len(corner)), mates)
    right = (
        np.arange(len(left)) - np.repeat(np.cumsum(mates) - mates, mates) + np.repeat(np.repeat(start, valence), mates)
    )
    unit = cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-15)
    a, b = order[left] // 3, order[right] // 3
    alike = np.einsum("nc,nc->n", unit[a], unit[b]) > math.cos(angle)
    total = np.zeros((len(corner), 3))
    np.add.at(total, order[left[alike]], cross[b[alike]])
    return np.asarray(total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-15))


def sheet(points: Float, wrap_v: bool = False) -> Mesh:
    """A closed surface from a grid (rows, columns, 3) whose columns wrap around; its first and last rows are poles,
    or, with `wrap_v`, meet. Normals are means over the faces that share a place."""
    columns = points.shape[1]
    closed = np.concatenate([points, points[:, :1]], axis=1)
    if wrap_v:
        closed = np.concatenate([closed, closed[:1]], axis=0)
    v, u = np.meshgrid(np.linspace(0, 1, len(closed)), np.linspace(0, 1, columns + 1), indexing="ij")
    vertices, faces = closed.reshape(-1, 3), shapes.grid(columns + 1, len(closed))
    cross = face_cross(vertices, faces)
    faces, cross = faces[np.linalg.norm(cross, axis=1) > 1e-12], cross[np.linalg.norm(cross, axis=1) > 1e-12]
    _, same = np.unique(np.round(vertices, 9), axis=0, return_inverse=True)
    total = np.zeros((same.max() + 1, 3))
    for corner in range(3):
        np.add.at(total, same.ravel()[faces[:, corner]], cross)
    normals = total[same.ravel()]
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-15)
    return Mesh(vertices, faces, normals, np.stack([u, v], axis=-1).reshape(-1, 2))


def face_cross(vertices: Float, faces: Indices) -> Float:
    """Cross products (F, 3) of the triangles' sides: normals, of twice their areas' length."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return np.asarray(np.cross(b - a, c - a))


def _globe(rows: int = 28, columns: int = 48) -> tuple[Float, Float]:
    """Latitude (rows, 1) from the south pole and longitude (1, columns)."""
    return (
        np.linspace(-math.pi / 2, math.pi / 2, rows)[:, None],
        np.linspace(0, 2 * math.pi, columns, endpoint=False)[None, :],
    )


def _directions() -> Float:
    lat, lon = _globe()
    xyz = np.stack(np.broadcast_arrays(np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)), -1)
    xyz[[0, -1]] = [[[0, 0, -1]], [[0, 0, 1]]]
    return xyz


def ball(rng: Rng) -> Solid:
    """A sphere."""
    return unit("ball", sheet(_directions()), False, (5.2, 3.14), True)


def ellipsoid(rng: Rng) -> Solid:
    """A sphere stretched along its axes."""
    return unit("ellipsoid", sheet(_directions() * rng.uniform(0.5, 1.0, 3)), False, (4.4, 2.6), True)


def superquadric(rng: Rng) -> Solid:
    """Between box, cylinder, sphere and octahedron. Source: Barr, Superquadrics, IEEE CG&A 1(1), 1981."""
    e1, e2 = rng.choice([0.25, 0.4, 0.7, 1.0, 1.6], 2)
    lat, lon = _globe(32, 64)

    def power(x: Float, e: float) -> Float:
        return np.asarray(np.sign(x) * np.abs(x) ** e)

    ring = power(np.cos(lat), e1)
    ring[[0, -1]] = 0.0
    xyz = np.stack(
        np.broadcast_arrays(ring * power(np.cos(lon), e2), ring * power(np.sin(lon), e2), power(np.sin(lat), e1)), -1
    )
    return unit("superquadric", sheet(xyz * rng.uniform(0.55, 1.0, 3)), False, (4.8, 2.8), True)


def pebble(rng: Rng) -> Solid:
    """A sphere displaced by a few waves: river pebbles and rocks."""
    xyz = _directions()
    r = np.ones(xyz.shape[:2])
    for frequency in (1.5, 2.5, 4.0, 7.0):
        waves = rng.normal(0, 1, (4, 3)) * frequency
        r += 0.09 / frequency**0.8 * np.sin(xyz @ waves.T + rng.uniform(0, 6.28, 4)).sum(axis=-1)
    return unit("pebble", sheet(xyz * r[..., None] * rng.uniform(0.6, 1.0, 3)), False, (4.6, 2.7), True)


def blob(rng: Rng) -> Solid:
    """A sphere with ridges running around it: gourds, sea urchins, twisted ornaments."""
    lat, lon = _globe(36, 72)
    count, twist, depth = int(rng.integers(5, 11)), rng.uniform(-2, 2), rng.uniform(0.05, 0.18)
    r = 1 + depth * np.cos(count * lon + twist * lat) * np.cos(lat) ** 0.7
    xyz = np.stack(np.broadcast_arrays(r * np.cos(lat) * np.cos(lon), r * np.cos(lat) * np.sin(lon), np.sin(lat)), -1)
    xyz[[0, -1], :, :2] = 0.0
    return unit("blob", sheet(xyz * [1, 1, rng.uniform(0.6, 1.1)]), False, (5.0, 2.8), True)


def ring(rng: Rng) -> Solid:
    """A torus, round or ridged."""
    thick, count = rng.uniform(0.18, 0.42), int(rng.integers(4, 12))
    depth = float(rng.choice([0.0, 0.0, 0.12]))
    theta = np.linspace(0, 2 * math.pi, 24, endpoint=False)[:, None] + math.pi
    phi = np.linspace(0, 2 * math.pi, 72, endpoint=False)[None, :]
    r = thick * (1 + depth * np.cos(count * phi))
    across = 1 + r * np.cos(theta)
    xyz = np.stack(np.broadcast_arrays(across * np.cos(phi), across * np.sin(phi), r * np.sin(theta)), -1)
    return unit("ring", sheet(xyz, wrap_v=True), False, (6.28, 6.28 * thick), True)


def knot(rng: Rng) -> Solid:
    """A thick (p, q) torus knot."""
    p, q = [(2, 3), (3, 2), (2, 5)][int(rng.integers(3))]
    t = np.linspace(0, 2 * math.pi, 160, endpoint=False)

    def curve(t: Float) -> Float:
        r = 2 + np.cos(q * t)
        return np.stack([r * np.cos(p * t), r * np.sin(p * t), np.sin(q * t)], axis=-1)

    step = 1e-3
    tangent = curve(t + step) - curve(t - step)
    bend = curve(t + step) + curve(t - step) - 2 * curve(t)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    bend -= (bend * tangent).sum(axis=1, keepdims=True) * tangent
    bend /= np.linalg.norm(bend, axis=1, keepdims=True)
    side = np.cross(tangent, bend)
    a = np.linspace(0, 2 * math.pi, 14, endpoint=False)[None, :, None]
    points = curve(t)[:, None] + 0.42 * (np.cos(a) * bend[:, None] + np.sin(a) * side[:, None])
    return unit("knot", sheet(points.swapaxes(0, 1)[::-1], wrap_v=True), False, (24.0, 2.6), True)


def block(rng: Rng) -> Solid:
    """A box with softened edges."""
    extents = rng.uniform(0.35, 1.0, 3) if rng.random() < 0.7 else np.ones(3)
    return cuboid("block", extents, rng.uniform(0.02, 0.14) * float(extents.min()), upright=False)


def cuboid(kind: str, extents: Float, radius: float, upright: bool = True) -> Solid:
    """A rounded box of these proportions; patterns at their own scale on every side."""
    return unit(kind, shapes.rounded_box(np.asarray(extents), radius, 2, tile=1.0), upright)
