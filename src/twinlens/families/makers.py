"""How the bodies of `kinds.KINDS` are made: functions of a random stream, which draws their proportions.

Profiles of lathed bodies run up the outside and, in hollow ones, down the inside; a point given twice is a hard edge.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from twinlens.families.draws import Rng, one_of
from twinlens.families.solids import (
    Solid,
    closed_grid,
    extruded,
    hard_edged,
    hull,
    lathed,
    polar,
    unit,
)
from twinlens.geometry import Float
from twinlens.scenes import shapes

Profile = list[tuple[float, float]]
"""Points (radius, height)."""

_RIM = 0.018  # of a tin
_GOLDEN = (1 + math.sqrt(5)) / 2


# Vessels.


def _hollow(outside: Profile, wall: float, floor: float) -> Float:
    """The profile of a vessel from its outside, foot to lip: the inside is `wall` thinner and ends at `floor`."""
    foot, lip = outside[0], outside[-1]
    outer = [(0.0, foot[1]), foot, *outside]
    inner = [(max(r - wall, 0.35 * r), h) for r, h in reversed(outside) if h > floor]
    below_lip = [point for point in inner if point[1] < lip[1] - 1e-6]
    inner = [(lip[0] - wall, lip[1]), *below_lip]
    end = inner[-1][0]
    return np.array([*outer, lip, *inner, (0.7 * end, floor), (0.0, floor)])


def vase(rng: Rng) -> Solid:
    belly = rng.uniform(0.3, 0.5)
    neck = rng.uniform(0.09, 0.24)
    tall = rng.uniform(0.9, 1.7)
    foot = rng.uniform(0.4, 0.75)
    lip = rng.uniform(1.1, 1.7)
    at = rng.uniform(0.25, 0.6)  # of the height: the widest place
    outside = [
        (foot * belly, 0.0),
        (0.5 * (foot * belly + belly) * 1.1, 0.5 * at * tall),
        (belly, at * tall),
        (0.55 * belly + 0.45 * neck, (0.45 * at + 0.55 * 0.8) * tall),
        (neck, 0.86 * tall),
        (neck * lip, tall),
    ]
    return lathed(_hollow(outside, 0.03, 0.06))


def bottle(rng: Rng) -> Solid:
    r = rng.uniform(0.2, 0.36)
    tall = rng.uniform(1.1, 1.8)
    neck = rng.uniform(0.07, 0.1)
    shoulder = rng.uniform(0.5, 0.66) * tall
    profile = [
        (0, 0),
        (0.92 * r, 0),
        (0.92 * r, 0),
        (r, 0.05),
        (r, 0.6 * shoulder),
        (r, shoulder),
        (0.75 * r, shoulder + 0.13),
        (neck * 1.15, shoulder + 0.26),
        (neck, tall - 0.12),
        (neck, tall - 0.1),
        (neck, tall - 0.1),
        (neck * 1.3, tall - 0.1),
        (neck * 1.3, tall - 0.1),
        (neck * 1.3, tall),
        (neck * 1.3, tall),
        (0, tall),
    ]
    return lathed(profile)


def bowl(rng: Rng) -> Solid:
    deep = rng.uniform(0.25, 0.5)
    foot = rng.uniform(0.18, 0.28)
    outside = [
        (foot, 0.0),
        (foot, 0.03),
        (0.33, 0.25 * deep),
        (0.46, 0.62 * deep),
        (0.5, deep),
    ]
    return lathed(_hollow(outside, 0.03, 0.055))


def cup(rng: Rng) -> Solid:
    tall = rng.uniform(0.7, 1.2)
    foot = rng.uniform(0.26, 0.4)
    lip = rng.uniform(0.34, 0.44)
    middle = rng.uniform(0.95, 1.15)
    outside = [
        (foot, 0.0),
        (foot * 1.02, 0.04),
        (0.5 * (foot + lip) * middle, 0.5 * tall),
        (lip, tall),
    ]
    return lathed(_hollow(outside, 0.03, 0.06))


def goblet(rng: Rng) -> Solid:
    tall = rng.uniform(1.1, 1.6)
    r = rng.uniform(0.26, 0.36)
    profile = [
        (0, 0),
        (0.28, 0),
        (0.28, 0),
        (0.26, 0.03),
        (0.06, 0.09),
        (0.04, 0.25 * tall),
        (0.05, 0.45 * tall),
        (0.6 * r, 0.52 * tall),
        (r, 0.7 * tall),
        (0.88 * r, tall),
        (0.88 * r, tall),
        (0.88 * r - 0.025, tall),
        (r - 0.025, 0.7 * tall),
        (0.5 * r, 0.56 * tall),
        (0, 0.53 * tall),
    ]
    return lathed(profile)


def plate(rng: Rng) -> Solid:
    rise = rng.uniform(0.05, 0.1)
    profile = [
        (0, 0),
        (0.3, 0),
        (0.3, 0),
        (0.33, 0.012),
        (0.4, 0.5 * rise),
        (0.5, rise),
        (0.5, rise),
        (0.5, rise + 0.02),
        (0.5, rise + 0.02),
        (0.4, 0.5 * rise + 0.022),
        (0.31, 0.03),
        (0, 0.03),
    ]
    return lathed(profile)


def jar(rng: Rng) -> Solid:
    """A jar with a lid and its knob."""
    r = rng.uniform(0.34, 0.48)
    tall = rng.uniform(0.6, 1.1)
    lid = tall + 0.09
    profile = [
        (0, 0),
        (r, 0),
        (r, 0),
        (r * 1.04, 0.5 * tall),
        (r, tall),
        (r, tall),
        (r * 1.07, tall),
        (r * 1.07, tall),
        (r * 1.07, lid),
        (r * 1.07, lid),
        (0.3 * r, lid + 0.05),
        (0.12 * r, lid + 0.09),
        (0.22 * r, lid + 0.17),
        (0, lid + 0.23),
    ]
    return lathed(profile)


def tin(rng: Rng) -> Solid:
    """A tin with a rim at both ends."""
    r = rng.uniform(0.28, 0.5)
    tall = rng.uniform(0.4, 1.2)
    bottom = [
        (0, 0.012),
        (r - _RIM, 0.012),
        (r - _RIM, 0),
        (r + _RIM, 0),
        (r + _RIM, 0),
        (r + _RIM, 0.03),
        (r + _RIM, 0.03),
        (r, 0.045),
        (r, 0.045),
    ]
    top = [
        (r, tall - 0.045),
        (r, tall - 0.045),
        (r + _RIM, tall - 0.03),
        (r + _RIM, tall - 0.03),
        (r + _RIM, tall),
        (r + _RIM, tall),
        (r - _RIM, tall),
        (r - _RIM, tall),
        (r - _RIM, tall - 0.012),
        (r - _RIM, tall - 0.012),
        (0, tall - 0.012),
    ]
    return lathed([*bottom, *top], smooth=False)


def candle(rng: Rng) -> Solid:
    r = rng.uniform(0.16, 0.36)
    tall = rng.uniform(0.5, 1.2)
    profile = [
        (0, 0),
        (r, 0),
        (r, 0),
        (r, tall - 0.06),
        (r, tall - 0.06),
        (0.96 * r, tall - 0.015),
        (0.85 * r, tall),
        (0.5 * r, tall - 0.02),
        (0, tall - 0.03),
    ]
    return lathed(profile)


# Fruit and other turned bodies.


def apple(rng: Rng) -> Solid:
    wide = rng.uniform(0.46, 0.54)
    profile = [
        (0, 0.07),
        (0.12, 0.012),
        (0.22, 0.0),
        (0.36, 0.09),
        (wide, 0.42),
        (0.9 * wide, 0.72),
        (0.26, 0.86),
        (0.1, 0.82),
        (0, 0.72),
    ]
    return lathed(profile)


def pear(rng: Rng) -> Solid:
    wide = rng.uniform(0.9, 1.1)
    profile = [
        (0, 0.05),
        (0.1, 0.01),
        (0.2, 0),
        (0.36, 0.1),
        (0.42, 0.34),
        (0.3, 0.66),
        (0.2, 0.88),
        (0.13, 1.02),
        (0, 1.06),
    ]
    return lathed(np.multiply(profile, [wide, 1.0]))


def egg(rng: Rng) -> Solid:
    latitude = np.linspace(-np.pi / 2, np.pi / 2, 12)
    radius = 0.38 * np.cos(latitude) * (1 - 0.12 * np.sin(latitude))
    profile = np.stack([radius, 0.52 * np.sin(latitude)], axis=-1)
    profile[[0, -1], 0] = 0.0
    return lathed(profile, upright=False)


def pawn(rng: Rng) -> Solid:
    waist = rng.uniform(0.1, 0.16)
    head = rng.uniform(0.18, 0.24)
    profile = [
        (0, 0),
        (0.34, 0),
        (0.34, 0),
        (0.35, 0.07),
        (0.29, 0.12),
        (0.27, 0.18),
        (0.2, 0.24),
        (waist, 0.55),
        (waist + 0.01, 0.66),
        (0.22, 0.7),
        (0.22, 0.73),
        (0.11, 0.77),
        (head, 0.77 + 0.9 * head),
        (0.7 * head, 0.77 + 1.65 * head),
        (0, 0.77 + 1.95 * head),
    ]
    return lathed(profile)


def cylinder(rng: Rng) -> Solid:
    """A cylinder with bevelled edges."""
    r = rng.uniform(0.15, 0.5)
    tall = rng.uniform(0.3, 1.2)
    profile = [
        (0, 0),
        (r - 0.015, 0),
        (r, 0.015),
        (r, tall - 0.015),
        (r - 0.015, tall),
        (0, tall),
    ]
    return lathed(hard_edged(profile), upright=False, smooth=False)


def cone(rng: Rng) -> Solid:
    r = rng.uniform(0.3, 0.5)
    top = one_of(rng, [0.02, 0.02, 0.18])
    tall = rng.uniform(0.6, 1.2)
    profile = [(0, 0), (r, 0), (top, tall), (0, tall + 0.01)]
    return lathed(hard_edged(profile), smooth=False)


def capsule(rng: Rng) -> Solid:
    r = rng.uniform(0.18, 0.32)
    straight = rng.uniform(0.2, 0.7)
    angle = np.linspace(-np.pi / 2, 0, 7)
    quarter = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    quarter[0, 0] = 0.0
    upper = r * quarter[::-1] * [1, -1] + [0, straight]
    return lathed(np.vstack([r * quarter, upper]), upright=False)


# Boxes.


def _cuboid(extents: ArrayLike, radius: float = 0.012, upright: bool = True) -> Solid:
    """A rounded box of these proportions; patterns have the same scale on every side."""
    return unit(shapes.rounded_box(np.asarray(extents), radius, 2, tile=1.0), upright)


def book(rng: Rng) -> Solid:
    return _cuboid([1.0, rng.uniform(0.62, 0.8), rng.uniform(0.08, 0.26)])


def carton(rng: Rng) -> Solid:
    width, depth = rng.uniform(0.4, 1.0), rng.uniform(0.3, 0.8)
    return _cuboid([width, depth, rng.uniform(0.4, 1.1)])


def block(rng: Rng) -> Solid:
    """A rounded box, or a cube, that may rest on any side."""
    extents = rng.uniform(0.35, 1.0, 3) if rng.random() < 0.7 else np.ones(3)
    radius = rng.uniform(0.02, 0.14) * float(extents.min())
    return _cuboid(extents, radius, upright=False)


# Bodies from grids of points.


def _sphere_angles(rows: int = 28, columns: int = 48) -> tuple[Float, Float]:
    """Latitude (rows, 1) from the south pole, and longitude (1, columns)."""
    longitude = np.linspace(0, 2 * math.pi, columns, endpoint=False)
    return np.linspace(-math.pi / 2, math.pi / 2, rows)[:, None], longitude[None, :]


def _grid(x: Float, y: Float, z: Float) -> Float:
    """Points (rows, columns, 3) of coordinates that broadcast together."""
    return np.stack(np.broadcast_arrays(x, y, z), -1)


def _sphere() -> Float:
    lat, lon = _sphere_angles()
    ring = np.cos(lat)
    xyz = _grid(ring * np.cos(lon), ring * np.sin(lon), np.sin(lat))
    xyz[[0, -1]] = [[[0, 0, -1]], [[0, 0, 1]]]
    return xyz


def ball(rng: Rng) -> Solid:
    return closed_grid(_sphere(), (5.2, 3.14))


def ellipsoid(rng: Rng) -> Solid:
    return closed_grid(_sphere() * rng.uniform(0.5, 1.0, 3), (4.4, 2.6))


def superquadric(rng: Rng) -> Solid:
    """Between box, cylinder, sphere and octahedron. Source: Barr, Superquadrics, IEEE CG&A 1(1), 1981."""
    e1, e2 = rng.choice([0.25, 0.4, 0.7, 1.0, 1.6], 2)
    lat, lon = _sphere_angles(32, 64)

    def power(x: Float, e: float) -> Float:
        return np.asarray(np.sign(x) * np.abs(x) ** e)

    ring = power(np.cos(lat), e1)
    ring[[0, -1]] = 0.0
    x, y = ring * power(np.cos(lon), e2), ring * power(np.sin(lon), e2)
    xyz = _grid(x, y, power(np.sin(lat), e1))
    return closed_grid(xyz * rng.uniform(0.55, 1.0, 3), (4.8, 2.8))


def pebble(rng: Rng) -> Solid:
    """A sphere whose radius varies by plane waves of four frequencies."""
    xyz = _sphere()
    r = np.ones(xyz.shape[:2])
    for frequency in (1.5, 2.5, 4.0, 7.0):
        waves = rng.normal(0, 1, (4, 3)) * frequency
        phases = rng.uniform(0, 6.28, 4)
        r += 0.09 / frequency**0.8 * np.sin(xyz @ waves.T + phases).sum(axis=-1)
    return closed_grid(xyz * r[..., None] * rng.uniform(0.6, 1.0, 3), (4.6, 2.7))


def blob(rng: Rng) -> Solid:
    """A sphere with twisted ribs, which fade towards the poles."""
    lat, lon = _sphere_angles(36, 72)
    count = int(rng.integers(5, 11))
    twist = rng.uniform(-2, 2)
    depth = rng.uniform(0.05, 0.18)
    r = 1 + depth * np.cos(count * lon + twist * lat) * np.cos(lat) ** 0.7
    ring = r * np.cos(lat)
    xyz = _grid(ring * np.cos(lon), ring * np.sin(lon), np.sin(lat))
    xyz[[0, -1], :, :2] = 0.0
    return closed_grid(xyz * [1, 1, rng.uniform(0.6, 1.1)], (5.0, 2.8))


def ring(rng: Rng) -> Solid:
    """A torus, in some cases with ribs."""
    thick = rng.uniform(0.18, 0.42)
    count = int(rng.integers(4, 12))
    depth = one_of(rng, [0.0, 0.0, 0.12])
    theta = np.linspace(0, 2 * math.pi, 24, endpoint=False)[:, None] + math.pi
    phi = np.linspace(0, 2 * math.pi, 72, endpoint=False)[None, :]
    r = thick * (1 + depth * np.cos(count * phi))
    across = 1 + r * np.cos(theta)
    xyz = _grid(across * np.cos(phi), across * np.sin(phi), r * np.sin(theta))
    return closed_grid(xyz, (6.28, 6.28 * thick), wrap_v=True)


def knot(rng: Rng) -> Solid:
    """A tube along a torus knot, with the frame of its curvature (Frenet's), by differences."""
    p, q = one_of(rng, [(2, 3), (3, 2), (2, 5)])
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
    angle = np.linspace(0, 2 * math.pi, 14, endpoint=False)[None, :, None]
    around = np.cos(angle) * bend[:, None] + np.sin(angle) * side[:, None]
    points = curve(t)[:, None] + 0.42 * around
    return closed_grid(points.swapaxes(0, 1)[::-1], (24.0, 2.6), wrap_v=True)


# Polyhedra and prisms.


def _cyclic(
    first: tuple[float, ...], second: tuple[float, ...]
) -> list[tuple[float, float, float]]:
    """The points (0, a, b) for all a and b, and their cyclic permutations."""
    return [p for a in first for b in second for p in ((0, a, b), (a, b, 0), (b, 0, a))]


_TETRAHEDRON = [(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)]
_OCTAHEDRON = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]
_ICOSAHEDRON = _cyclic((-1, 1), (-_GOLDEN, _GOLDEN))
_CUBE = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
_DODECAHEDRON = _CUBE + _cyclic((-1 / _GOLDEN, 1 / _GOLDEN), (-_GOLDEN, _GOLDEN))
_CUBOCTAHEDRON = _cyclic((-1, 1), (-1, 1))
_POLYHEDRA: tuple[ArrayLike, ...] = (
    _TETRAHEDRON,
    _OCTAHEDRON,
    _ICOSAHEDRON,
    _DODECAHEDRON,
    _CUBOCTAHEDRON,
)


def crystal(rng: Rng) -> Solid:
    return hull(np.array(one_of(rng, _POLYHEDRA), dtype=np.float64))


def _directions(count: int) -> Float:
    """Unit vectors (count, 2) at equal angles."""
    angle = np.arange(count) * 2 * math.pi / count
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def star(rng: Rng) -> Solid:
    points = one_of(rng, range(4, 9))
    inner = rng.uniform(0.45, 0.7)
    radius = np.where(np.arange(2 * points) % 2 == 0, 1.0, inner)
    return extruded(radius[:, None] * _directions(2 * points), rng.uniform(0.25, 0.6))


def gear(rng: Rng) -> Solid:
    teeth = one_of(rng, range(8, 19))
    depth = rng.uniform(0.12, 0.22)
    height = rng.uniform(0.2, 0.5)
    bore = rng.uniform(0.2, 0.45)

    def radius(angle: Float) -> Float:
        gap = np.clip(0.5 + 1.6 * np.cos(teeth * angle), 0, 1)
        return np.asarray(1 - depth * gap)

    points_per_tooth = 16 if teeth < 12 else 12
    return extruded(polar(radius, points_per_tooth * teeth), height, bore, 0.02)


def flower(rng: Rng) -> Solid:
    petals = one_of(rng, range(3, 8))
    depth = rng.uniform(0.1, 0.3)
    height = rng.uniform(0.25, 0.8)
    return extruded(polar(lambda angle: 1 + depth * np.cos(petals * angle)), height)


def heart(rng: Rng) -> Solid:
    t = np.linspace(0, 2 * math.pi, 100, endpoint=False)
    y = 13 * np.cos(t) - 5 * np.cos(2 * t) - 2 * np.cos(3 * t) - np.cos(4 * t) + 1.5
    outline = np.stack([16 * np.sin(t) ** 3, y], axis=-1)[::-1] / 16
    return extruded(outline, rng.uniform(0.3, 0.6))


def prism(rng: Rng) -> Solid:
    sides = one_of(rng, [3, 5, 6, 8])
    return extruded(_directions(sides), rng.uniform(0.5, 2.2))


def nut(rng: Rng) -> Solid:
    """A hexagon with 60 points, so that the bore is round."""
    angle = np.arange(60) * math.pi / 30
    from_middle_of_side = angle % (math.pi / 3) - math.pi / 6
    radius = np.cos(math.pi / 6) / np.cos(from_middle_of_side)
    return extruded(radius[:, None] * _directions(60), rng.uniform(0.5, 0.9), 0.52)
