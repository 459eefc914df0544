"""Bodies of a scene: the 33 kinds, with their sizes, weights and patterns, or a user's mesh.

Profiles of lathed bodies run up the outside and, in hollow ones, down the inside; a point given twice is a hard edge.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from twinlens.families.composition import Composition
from twinlens.families.draws import Rng, log_uniform, one_of, weighted
from twinlens.families.materials import FINISHES, body_material, user_texture
from twinlens.families.solids import (
    Solid,
    box_mapped,
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
from twinlens.scenes.materials import Material


def _hollow(outside: list[tuple[float, float]], wall: float, floor: float) -> Float:
    """The profile of a vessel from its outside, foot to lip: the inside is `wall` thinner and ends at `floor`."""
    outer = [(0.0, outside[0][1]), outside[0], *outside]
    lip = outside[-1]
    inner = [(max(r - wall, 0.35 * r), h) for r, h in reversed(outside) if h > floor]
    inner = [(lip[0] - wall, lip[1])] + [p for p in inner if p[1] < lip[1] - 1e-6]
    end = inner[-1][0]
    return np.array([*outer, lip, *inner, (0.7 * end, floor), (0.0, floor)])


def _drawn(
    ranges: Sequence[Sequence[float]], make: Callable[..., Solid]
) -> Callable[[Rng], Solid]:
    """A maker of bodies from measures drawn in order: uniform in a tuple (low, high), or one of another sequence."""
    return lambda rng: make(
        *(rng.uniform(*m) if isinstance(m, tuple) else one_of(rng, m) for m in ranges)
    )


def _turned(
    ranges: Sequence[Sequence[float]], profile: Callable[..., ArrayLike], **how: bool
) -> Callable[[Rng], Solid]:
    return _drawn(ranges, lambda *measures: lathed(profile(*measures), **how))


def _cuboid(extents: ArrayLike, radius: float = 0.012, upright: bool = True) -> Solid:
    """A rounded box of these proportions; patterns have the same scale on every side."""
    return unit(shapes.rounded_box(np.asarray(extents), radius, 2, tile=1.0), upright)


def _block(rng: Rng) -> Solid:
    extents = rng.uniform(0.35, 1.0, 3) if rng.random() < 0.7 else np.ones(3)
    return _cuboid(
        extents, rng.uniform(0.02, 0.14) * float(extents.min()), upright=False
    )


def _sphere_angles(rows: int = 28, columns: int = 48) -> tuple[Float, Float]:
    """Latitude (rows, 1) from the south pole, and longitude (1, columns)."""
    longitude = np.linspace(0, 2 * math.pi, columns, endpoint=False)
    return np.linspace(-math.pi / 2, math.pi / 2, rows)[:, None], longitude[None, :]


def _sphere() -> Float:
    lat, lon = _sphere_angles()
    xyz = np.stack(
        np.broadcast_arrays(
            np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)
        ),
        -1,
    )
    xyz[[0, -1]] = [[[0, 0, -1]], [[0, 0, 1]]]
    return xyz


def _superquadric(rng: Rng) -> Solid:
    """Between box, cylinder, sphere and octahedron. Source: Barr, Superquadrics, IEEE CG&A 1(1), 1981."""
    e1, e2 = rng.choice([0.25, 0.4, 0.7, 1.0, 1.6], 2)
    lat, lon = _sphere_angles(32, 64)

    def power(x: Float, e: float) -> Float:
        return np.asarray(np.sign(x) * np.abs(x) ** e)

    ring = power(np.cos(lat), e1)
    ring[[0, -1]] = 0.0
    x, y, z = (
        ring * power(np.cos(lon), e2),
        ring * power(np.sin(lon), e2),
        power(np.sin(lat), e1),
    )
    xyz = np.stack(np.broadcast_arrays(x, y, z), -1)
    return closed_grid(xyz * rng.uniform(0.55, 1.0, 3), (4.8, 2.8))


def _pebble(rng: Rng) -> Solid:
    xyz = _sphere()
    r = np.ones(xyz.shape[:2])
    for frequency in (1.5, 2.5, 4.0, 7.0):
        waves = rng.normal(0, 1, (4, 3)) * frequency
        r += (
            0.09
            / frequency**0.8
            * np.sin(xyz @ waves.T + rng.uniform(0, 6.28, 4)).sum(axis=-1)
        )
    return closed_grid(xyz * r[..., None] * rng.uniform(0.6, 1.0, 3), (4.6, 2.7))


def _blob(rng: Rng) -> Solid:
    lat, lon = _sphere_angles(36, 72)
    count, twist, depth = (
        int(rng.integers(5, 11)),
        rng.uniform(-2, 2),
        rng.uniform(0.05, 0.18),
    )
    r = 1 + depth * np.cos(count * lon + twist * lat) * np.cos(lat) ** 0.7
    xyz = np.stack(
        np.broadcast_arrays(
            r * np.cos(lat) * np.cos(lon), r * np.cos(lat) * np.sin(lon), np.sin(lat)
        ),
        -1,
    )
    xyz[[0, -1], :, :2] = 0.0
    return closed_grid(xyz * [1, 1, rng.uniform(0.6, 1.1)], (5.0, 2.8))


def _ring(rng: Rng) -> Solid:
    thick, count = rng.uniform(0.18, 0.42), int(rng.integers(4, 12))
    depth = one_of(rng, [0.0, 0.0, 0.12])
    theta = np.linspace(0, 2 * math.pi, 24, endpoint=False)[:, None] + math.pi
    phi = np.linspace(0, 2 * math.pi, 72, endpoint=False)[None, :]
    r = thick * (1 + depth * np.cos(count * phi))
    across = 1 + r * np.cos(theta)
    xyz = np.stack(
        np.broadcast_arrays(
            across * np.cos(phi), across * np.sin(phi), r * np.sin(theta)
        ),
        -1,
    )
    return closed_grid(xyz, (6.28, 6.28 * thick), wrap_v=True)


def _knot(rng: Rng) -> Solid:
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
    a = np.linspace(0, 2 * math.pi, 14, endpoint=False)[None, :, None]
    points = curve(t)[:, None] + 0.42 * (
        np.cos(a) * bend[:, None] + np.sin(a) * side[:, None]
    )
    return closed_grid(points.swapaxes(0, 1)[::-1], (24.0, 2.6), wrap_v=True)


def _cyclic(
    first: tuple[float, ...], second: tuple[float, ...]
) -> list[tuple[float, float, float]]:
    return [p for a in first for b in second for p in ((0, a, b), (a, b, 0), (b, 0, a))]


_GOLDEN = (1 + math.sqrt(5)) / 2
_POLYHEDRA = (  # corners of tetrahedron, octahedron, icosahedron, dodecahedron, cuboctahedron
    [(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)],
    [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)],
    _cyclic((-1, 1), (-_GOLDEN, _GOLDEN)),
    [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    + _cyclic((-1 / _GOLDEN, 1 / _GOLDEN), (-_GOLDEN, _GOLDEN)),
    _cyclic((-1, 1), (-1, 1)),
)


def _directions(count: int) -> Float:
    angle = np.arange(count) * 2 * math.pi / count
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


@dataclass(frozen=True)
class Kind:
    """The range of a body's largest extent in metres, its weight in draws, its patterns, and how it is made."""

    size: tuple[float, float]
    weight: float
    patterns: tuple[str, ...]
    make: Callable[[Rng], Solid]


_GLAZED = (
    "plain",
    "cloudy",
    "speckled",
    "stripes",
    "zigzag",
    "dots",
    "scales",
    "triangles",
    "marble",
)
_FRUIT = ("cloudy", "speckled", "plain")
_PRINTED = ("art", "stripes", "triangles", "dots", "plain", "camouflage", "checks")
_TOY = (
    "plain",
    "wood",
    "stripes",
    "dots",
    "triangles",
    "checks",
    "cloudy",
    "mosaic",
    "camouflage",
)
_RIM = 0.018  # of a tin
_QUARTER = np.stack(
    [np.cos(np.linspace(-np.pi / 2, 0, 7)), np.sin(np.linspace(-np.pi / 2, 0, 7))],
    axis=-1,
)
_QUARTER[0, 0] = 0.0
_LATITUDE = np.linspace(-np.pi / 2, np.pi / 2, 12)
_EGG = np.stack(
    [
        0.38 * np.cos(_LATITUDE) * (1 - 0.12 * np.sin(_LATITUDE)),
        0.52 * np.sin(_LATITUDE),
    ],
    axis=-1,
)
_EGG[[0, -1], 0] = 0.0
_TURN = np.linspace(0, 2 * math.pi, 100, endpoint=False)
_HEART_Y = (
    13 * np.cos(_TURN)
    - 5 * np.cos(2 * _TURN)
    - 2 * np.cos(3 * _TURN)
    - np.cos(4 * _TURN)
    + 1.5
)
_HEART = np.stack([16 * np.sin(_TURN) ** 3, _HEART_Y], axis=-1)[::-1] / 16
_SIXTIETHS = np.arange(60) * math.pi / 30
_NUT = (np.cos(math.pi / 6) / np.cos((_SIXTIETHS % (math.pi / 3)) - math.pi / 6))[
    :, None
] * _directions(60)

# fmt: off
KINDS: dict[str, Kind] = {
    "vase": Kind((0.18, 0.36), 1.6, _GLAZED,
        _turned([(0.3, 0.5), (0.09, 0.24), (0.9, 1.7), (0.4, 0.75), (1.1, 1.7), (0.25, 0.6)],
        lambda belly, neck, tall, foot, lip, at: _hollow([
            (foot * belly, 0.0), (0.5 * (foot * belly + belly) * 1.1, 0.5 * at * tall), (belly, at * tall),
            (0.55 * belly + 0.45 * neck, (0.45 * at + 0.55 * 0.8) * tall), (neck, 0.86 * tall), (neck * lip, tall),
        ], 0.03, 0.06))),
    "bottle": Kind((0.2, 0.34), 1.3, ("plain", "cloudy", "stripes", "speckled"),
        _turned([(0.2, 0.36), (1.1, 1.8), (0.07, 0.1), (0.5, 0.66)], lambda r, tall, neck, at: [
            (0, 0), (0.92 * r, 0), (0.92 * r, 0), (r, 0.05), (r, 0.6 * (at * tall)), (r, at * tall),
            (0.75 * r, at * tall + 0.13), (neck * 1.15, at * tall + 0.26), (neck, tall - 0.12), (neck, tall - 0.1),
            (neck, tall - 0.1), (neck * 1.3, tall - 0.1), (neck * 1.3, tall - 0.1), (neck * 1.3, tall),
            (neck * 1.3, tall), (0, tall),
        ])),
    "bowl": Kind((0.14, 0.28), 1.2, _GLAZED, _turned([(0.25, 0.5), (0.18, 0.28)], lambda deep, foot: _hollow(
        [(foot, 0.0), (foot, 0.03), (0.33, 0.25 * deep), (0.46, 0.62 * deep), (0.5, deep)], 0.03, 0.055))),
    "cup": Kind((0.08, 0.13), 1.4, _GLAZED,
        _turned([(0.7, 1.2), (0.26, 0.4), (0.34, 0.44), (0.95, 1.15)], lambda tall, foot, lip, middle: _hollow(
            [(foot, 0.0), (foot * 1.02, 0.04), (0.5 * (foot + lip) * middle, 0.5 * tall), (lip, tall)], 0.03, 0.06))),
    "goblet": Kind((0.13, 0.2), 0.6, ("plain", "cloudy", "wood"), _turned([(1.1, 1.6), (0.26, 0.36)], lambda tall, r: [
        (0, 0), (0.28, 0), (0.28, 0), (0.26, 0.03), (0.06, 0.09), (0.04, 0.25 * tall),
        (0.05, 0.45 * tall), (0.6 * r, 0.52 * tall), (r, 0.7 * tall), (0.88 * r, tall), (0.88 * r, tall),
        (0.88 * r - 0.025, tall), (r - 0.025, 0.7 * tall), (0.5 * r, 0.56 * tall), (0, 0.53 * tall),
    ])),
    "plate": Kind((0.18, 0.28), 0.7, _GLAZED, _turned([(0.05, 0.1)], lambda rise: [
        (0, 0), (0.3, 0), (0.3, 0), (0.33, 0.012), (0.4, 0.5 * rise), (0.5, rise), (0.5, rise), (0.5, rise + 0.02),
        (0.5, rise + 0.02), (0.4, 0.5 * rise + 0.022), (0.31, 0.03), (0, 0.03),
    ])),
    "jar": Kind((0.12, 0.24), 1.0, _GLAZED, _turned([(0.34, 0.48), (0.6, 1.1)], lambda r, tall: [  # with a lid
        (0, 0), (r, 0), (r, 0), (r * 1.04, 0.5 * tall), (r, tall), (r, tall), (r * 1.07, tall), (r * 1.07, tall),
        (r * 1.07, tall + 0.09), (r * 1.07, tall + 0.09), (0.3 * r, tall + 0.09 + 0.05), (0.12 * r, tall + 0.09 + 0.09),
        (0.22 * r, tall + 0.09 + 0.17), (0, tall + 0.09 + 0.23),
    ])),
    "tin": Kind((0.08, 0.15), 1.0, _PRINTED, _turned([(0.28, 0.5), (0.4, 1.2)], lambda r, tall: [
        (0, 0.012), (r - _RIM, 0.012), (r - _RIM, 0), (r + _RIM, 0), (r + _RIM, 0), (r + _RIM, 0.03), (r + _RIM, 0.03),
        (r, 0.045), (r, 0.045), (r, tall - 0.045), (r, tall - 0.045), (r + _RIM, tall - 0.03), (r + _RIM, tall - 0.03),
        (r + _RIM, tall), (r + _RIM, tall), (r - _RIM, tall), (r - _RIM, tall), (r - _RIM, tall - 0.012),
        (r - _RIM, tall - 0.012), (0, tall - 0.012),
    ], smooth=False)),
    "candle": Kind((0.07, 0.2), 0.8, ("plain", "cloudy", "stripes", "marble"),
        _turned([(0.16, 0.36), (0.5, 1.2)], lambda r, tall: [
            (0, 0), (r, 0), (r, 0), (r, tall - 0.06), (r, tall - 0.06), (0.96 * r, tall - 0.015), (0.85 * r, tall),
            (0.5 * r, tall - 0.02), (0, tall - 0.03),
        ])),
    "apple": Kind((0.075, 0.095), 1.4, _FRUIT, _turned([(0.46, 0.54)], lambda wide: [
        (0, 0.07), (0.12, 0.012), (0.22, 0.0), (0.36, 0.09), (wide, 0.42), (0.9 * wide, 0.72), (0.26, 0.86),
        (0.1, 0.82), (0, 0.72),
    ])),
    "pear": Kind((0.09, 0.12), 0.9, _FRUIT, _turned([(0.9, 1.1)], lambda wide: np.multiply([
        (0, 0.05), (0.1, 0.01), (0.2, 0), (0.36, 0.1), (0.42, 0.34), (0.3, 0.66), (0.2, 0.88), (0.13, 1.02), (0, 1.06),
    ], [wide, 1.0]))),
    "egg": Kind((0.06, 0.09), 0.6, _FRUIT, lambda _: lathed(_EGG, upright=False)),
    "pawn": Kind((0.09, 0.22), 0.8, ("wood", "plain", "marble"),
        _turned([(0.1, 0.16), (0.18, 0.24)], lambda waist, head: [
            (0, 0), (0.34, 0), (0.34, 0), (0.35, 0.07), (0.29, 0.12), (0.27, 0.18), (0.2, 0.24), (waist, 0.55),
            (waist + 0.01, 0.66), (0.22, 0.7), (0.22, 0.73), (0.11, 0.77), (head, 0.77 + 0.9 * head),
            (0.7 * head, 0.77 + 1.65 * head), (0, 0.77 + 1.95 * head),
        ])),
    "cylinder": Kind((0.08, 0.22), 0.7, _TOY, _turned([(0.15, 0.5), (0.3, 1.2)], lambda r, tall: hard_edged(
        [(0, 0), (r - 0.015, 0), (r, 0.015), (r, tall - 0.015), (r - 0.015, tall), (0, tall)],
    ), upright=False, smooth=False)),
    "cone": Kind((0.1, 0.2), 0.6, _TOY, _turned([(0.3, 0.5), [0.02, 0.02, 0.18], (0.6, 1.2)],
        lambda r, top, tall: hard_edged([(0, 0), (r, 0), (top, tall), (0, tall + 0.01)]), smooth=False)),
    "capsule": Kind((0.08, 0.18), 0.5, _TOY, _turned([(0.18, 0.32), (0.2, 0.7)], lambda r, straight: np.vstack(
        [r * _QUARTER, r * _QUARTER[::-1] * [1, -1] + [0, straight]]), upright=False)),
    "book": Kind((0.18, 0.3), 1.8, ("plain", "art", "stripes", "weave", "triangles", "cloudy", "scales"),
        lambda rng: _cuboid([1.0, rng.uniform(0.62, 0.8), rng.uniform(0.08, 0.26)])),
    "carton": Kind((0.1, 0.28), 1.4, _PRINTED,
        lambda rng: _cuboid([rng.uniform(0.4, 1.0), rng.uniform(0.3, 0.8), rng.uniform(0.4, 1.1)])),
    "block": Kind((0.06, 0.16), 1.2, _TOY, _block),
    "ball": Kind((0.07, 0.18), 1.2, ("stripes", "plain", "dots", "cloudy", "marble", "triangles"),
        lambda _: closed_grid(_sphere(), (5.2, 3.14))),
    "ellipsoid": Kind((0.08, 0.18), 0.5, _TOY,
        lambda rng: closed_grid(_sphere() * rng.uniform(0.5, 1.0, 3), (4.4, 2.6))),
    "superquadric": Kind((0.1, 0.22), 1.0, _TOY, _superquadric),
    "pebble": Kind((0.06, 0.2), 1.1, ("marble", "granite", "speckled", "cloudy", "chips"), _pebble),
    "blob": Kind((0.1, 0.2), 0.9, _GLAZED, _blob),
    "ring": Kind((0.1, 0.24), 0.8, _TOY, _ring),
    "knot": Kind((0.12, 0.26), 0.5, ("plain", "cloudy", "granite", "wood", "marble"), _knot),
    "crystal": Kind((0.08, 0.18), 0.8, ("plain", "granite", "marble", "wood", "chips"),
        lambda rng: hull(np.array(one_of(rng, _POLYHEDRA), dtype=np.float64))),
    "star": Kind((0.1, 0.2), 0.5, _TOY, _drawn([range(4, 9), (0.45, 0.7), (0.25, 0.6)],
        lambda points, inner, height: extruded(
            np.where(np.arange(2 * points) % 2 == 0, 1.0, inner)[:, None] * _directions(2 * points), height))),
    "gear": Kind((0.1, 0.24), 0.8, ("plain", "cloudy", "granite"),
        _drawn([range(8, 19), (0.12, 0.22), (0.2, 0.5), (0.2, 0.45)], lambda teeth, depth, height, bore: extruded(
            polar(lambda a: 1 - depth * np.clip(0.5 + 1.6 * np.cos(teeth * a), 0, 1),
                  16 * teeth if teeth < 12 else 12 * teeth), height, bore, 0.02))),
    "flower": Kind((0.1, 0.2), 0.5, _TOY, _drawn([range(3, 8), (0.1, 0.3), (0.25, 0.8)],
        lambda petals, depth, height: extruded(polar(lambda a: 1 + depth * np.cos(petals * a)), height))),
    "heart": Kind((0.08, 0.18), 0.4, ("plain", "cloudy", "wood", "dots"),
        lambda rng: extruded(_HEART, rng.uniform(0.3, 0.6))),
    "prism": Kind((0.08, 0.22), 0.6, _TOY,
        lambda rng: extruded(_directions(one_of(rng, [3, 5, 6, 8])), rng.uniform(0.5, 2.2))),
    "nut": Kind((0.07, 0.16), 0.5, ("plain", "granite"), lambda rng: extruded(_NUT, rng.uniform(0.5, 0.9), 0.52)),
}
# fmt: on
METALLIC = (
    "gear",
    "nut",
    "knot",
    "ring",
    "vase",
    "goblet",
    "tin",
    "ball",
    "crystal",
    "bowl",
    "capsule",
    "blob",
)
SOFT = ("book", "block", "ball", "blob", "ring", "star", "flower", "heart")
GLASSY = ("vase", "bottle", "goblet", "ball", "cup", "crystal")
_USER_SIZE = (0.14, 0.34)
_USER_PATTERNS = ("cloudy", "speckled", "granite", "stripes")


@dataclass(frozen=True, eq=False)
class Body:
    """A body whose largest extent is `size` metres; `kind` is "" for a user's mesh."""

    name: str
    kind: str
    solid: Solid
    size: float
    scene: Composition
    part: tuple[str | int, ...]

    def material(self, pixel: float) -> Material:
        """Its material where a pixel covers `pixel` metres: no texel is smaller than that."""
        scene, part = self.scene, self.part
        limited = {
            "metal": METALLIC,
            "mirror": METALLIC,
            "glass": GLASSY,
            "fabric": SOFT,
        }
        finishes = [
            name for name in FINISHES if self.kind in limited.get(name, (self.kind,))
        ]
        finish = weighted(
            scene.rng(*part, "finish"),
            finishes,
            [FINISHES[name][0] for name in finishes],
        )
        own = (
            None
            if finish in ("metal", "glass", "mirror")
            else user_texture(scene, *part)
        )
        names = KINDS[self.kind].patterns if self.kind else _USER_PATTERNS
        stream = scene.rng(*part, "texture")
        return body_material(
            stream,
            self.solid,
            self.size,
            pixel,
            scene.palette,
            finish,
            names if own is None else own,
        )


def draw_body(
    scene: Composition,
    part: tuple[str | int, ...],
    among: tuple[str, ...] | None = None,
) -> Body:
    """The body of one part of a scene, of one of the kinds `among`. Without `among`: of any kind, or a user's mesh."""
    rng = scene.rng(*part, "shape")
    if (
        among is None
        and scene.assets.meshes
        and scene.rng(*part, "own").random() < scene.assets.mesh_share
    ):
        drawn = scene.assets.draw("meshes", scene.rng(*part, "mesh"))
        if drawn is not None:
            name, mesh = drawn
            size = (
                mesh.size
                if scene.assets.keep_scale
                else float(rng.uniform(*_USER_SIZE))
            )
            if not mesh.materials and (mesh.normals is None or mesh.uv is None):
                mesh = box_mapped(mesh.vertices, mesh.faces, 30.0)
            return Body(name, "", Solid(mesh, True), size, scene, part)
    names = among or tuple(KINDS)
    name = weighted(
        scene.rng(*part, "kind"), names, [KINDS[each].weight for each in names]
    )
    size = log_uniform(scene.rng(*part, "size"), *KINDS[name].size)
    return Body(name, name, KINDS[name].make(rng), size, scene, part)
