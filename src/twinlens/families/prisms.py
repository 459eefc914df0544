"""Flat-sided bodies: polyhedra, and prisms over stars, gears, flowers, hearts, with their edges cut. See `solids`."""

import math
from collections.abc import Callable

import numpy as np

from twinlens.families.solids import Rng, Solid, box_mapped, face_cross, unit
from twinlens.geometry import Float


def crystal(rng: Rng) -> Solid:
    """One of the regular polyhedra, or a cut of one."""
    golden = (1 + math.sqrt(5)) / 2
    corners = {
        "tetrahedron": [(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)],
        "octahedron": [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)],
        "icosahedron": [p for a in (-1, 1) for b in (-golden, golden) for p in ((0, a, b), (a, b, 0), (b, 0, a))],
        "dodecahedron": [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
        + [p for a in (-1 / golden, 1 / golden) for b in (-golden, golden) for p in ((0, a, b), (a, b, 0), (b, 0, a))],
        "cuboctahedron": [p for a in (-1, 1) for b in (-1, 1) for p in ((0, a, b), (a, b, 0), (b, 0, a))],
    }
    name = list(corners)[int(rng.integers(len(corners)))]
    return hull_of(name, np.array(corners[name], dtype=np.float64))


def hull_of(kind: str, points: Float, upright: bool = False) -> Solid:
    """The convex hull of points, flat-sided."""
    from scipy.spatial import ConvexHull

    hull = ConvexHull(points)
    faces = hull.simplices.copy()
    inward = (face_cross(points, faces) * hull.equations[:, :3]).sum(axis=1) < 0
    faces[inward] = faces[inward][:, ::-1]
    return unit(kind, box_mapped(points, faces, 0.0), upright)


def extruded(kind: str, outline: Float, height: float, hole: float = 0.0, bevel: float = 0.03) -> Solid:
    """A prism over an outline (N, 2) that is seen whole from the origin, its edges cut; `hole`: a bore's radius."""
    n = len(outline)
    inner = outline * (1 - bevel / np.linalg.norm(outline, axis=1, keepdims=True))
    rings = [(inner, -height / 2), (outline, -height / 2 + bevel), (outline, height / 2 - bevel), (inner, height / 2)]
    if hole > 0:
        angle = np.arctan2(outline[:, 1], outline[:, 0])
        rim = hole * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        rings += [(rim, height / 2), (rim, -height / 2)]
    vertices = np.concatenate([np.column_stack([xy, np.full(n, z)]) for xy, z in rings])
    index = np.arange(len(rings) * n).reshape(len(rings), n)
    following = np.roll(index, -1, axis=1)
    pairs = list(zip(range(len(rings)), [*range(1, len(rings)), 0], strict=True))
    pairs = pairs if hole > 0 else pairs[:-1]
    faces = [np.stack([index[a], following[a], following[b]], -1) for a, b in pairs]
    faces += [np.stack([index[a], following[b], index[b]], -1) for a, b in pairs]
    if hole == 0:
        low, high = len(vertices), len(vertices) + 1
        vertices = np.vstack([vertices, [[0, 0, -height / 2], [0, 0, height / 2]]])
        faces.append(np.stack([following[0], index[0], np.full(n, low)], -1))
        faces.append(np.stack([index[-1], following[-1], np.full(n, high)], -1))
    return unit(kind, box_mapped(vertices, np.concatenate(faces), 25.0), False)


def polar(radius: Callable[[Float], Float], count: int = 120) -> Float:
    """Outline points (N, 2) of a radius that depends on the angle."""
    angle = np.linspace(0, 2 * math.pi, count, endpoint=False)
    return np.asarray(radius(angle)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1))


def star(rng: Rng) -> Solid:
    """A star of 4 to 8 points."""
    points, inner = int(rng.integers(4, 9)), rng.uniform(0.45, 0.7)
    angle = np.arange(2 * points) * math.pi / points
    outline = np.where(np.arange(2 * points) % 2 == 0, 1.0, inner)[:, None] * np.stack(
        [np.cos(angle), np.sin(angle)], -1
    )
    return extruded("star", outline, rng.uniform(0.25, 0.6))


def gear(rng: Rng) -> Solid:
    """A toothed wheel with a bore."""
    teeth, depth = int(rng.integers(8, 19)), rng.uniform(0.12, 0.22)
    outline = polar(
        lambda a: 1 - depth * np.clip(0.5 + 1.6 * np.cos(teeth * a), 0, 1), 16 * teeth if teeth < 12 else 12 * teeth
    )
    return extruded("gear", outline, rng.uniform(0.2, 0.5), hole=rng.uniform(0.2, 0.45), bevel=0.02)


def flower(rng: Rng) -> Solid:
    """A prism over a rounded flower, clover or wave."""
    petals, depth = int(rng.integers(3, 8)), rng.uniform(0.1, 0.3)
    return extruded("flower", polar(lambda a: 1 + depth * np.cos(petals * a)), rng.uniform(0.25, 0.8))


def heart(rng: Rng) -> Solid:
    """A heart, thick."""
    t = np.linspace(0, 2 * math.pi, 100, endpoint=False)
    x = 16 * np.sin(t) ** 3
    y = 13 * np.cos(t) - 5 * np.cos(2 * t) - 2 * np.cos(3 * t) - np.cos(4 * t) + 1.5
    return extruded("heart", np.stack([x, y], axis=-1)[::-1] / 16, rng.uniform(0.3, 0.6))


def prism(rng: Rng) -> Solid:
    """A bar of 3, 5, 6 or 8 sides."""
    sides = int(rng.choice([3, 5, 6, 8]))
    angle = np.arange(sides) * 2 * math.pi / sides
    return extruded("prism", np.stack([np.cos(angle), np.sin(angle)], -1), rng.uniform(0.5, 2.2))


def nut(rng: Rng) -> Solid:
    """A hexagonal nut."""
    angle = np.arange(60) * math.pi / 30
    apothem = np.cos(math.pi / 6) / np.cos((angle % (math.pi / 3)) - math.pi / 6)
    return extruded("nut", apothem[:, None] * np.stack([np.cos(angle), np.sin(angle)], -1), rng.uniform(0.5, 0.9), 0.52)
