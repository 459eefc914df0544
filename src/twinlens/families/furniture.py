"""Furniture: the origin is the middle of the footprint, the front faces -y, z is up. Lengths are in metres."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from twinlens.families.draws import Rng, one_of
from twinlens.families.solids import double_sided, hard_edged
from twinlens.scenes import shapes
from twinlens.scenes.placement import rotation, translation
from twinlens.scenes.scene import Mesh

DINING_HEIGHT = 0.74  # metres
Range = tuple[float, float]


@dataclass(frozen=True, eq=False)
class Shelf:
    """A horizontal rectangle to place objects on: middle (x, y), height, size (x, y), and the free height above it."""

    middle: tuple[float, float]
    height: float
    size: tuple[float, float]
    free: float = 1.0


@dataclass(frozen=True, eq=False)
class Piece:
    """A piece of furniture: parts (name, mesh, key of `materials.FURNITURE`), floor area (x, y), height, shelves.

    The meshes' (u, v) are in metres. The material "lit" is a lamp shade, "spines" are books.
    """

    kind: str
    parts: tuple[tuple[str, Mesh, str], ...]
    floor: tuple[float, float]
    height: float
    shelves: tuple[Shelf, ...] = ()


def board(
    extents: tuple[float, float, float],
    middle: tuple[float, float, float],
    radius: float = 0.0,
) -> Mesh:
    """A box of these extents; `radius` rounds its edges."""
    size = np.array(extents)
    box = shapes.box(size, tile=1.0)
    if radius > 0:
        box = shapes.rounded_box(size, radius, 3, tile=1.0)
    return shapes.transformed(box, translation(middle))


def rod(low: ArrayLike, high: ArrayLike, radius: float) -> Mesh:
    """A cylinder between the middles (3,) of its ends."""
    along = np.subtract(high, low)
    length = float(np.linalg.norm(along))
    profile = hard_edged([(0, 0), (radius, 0), (radius, length), (0, length)])
    bar = shapes.lathe(profile, 18, smooth=False)
    # A frame whose z axis is the rod's.
    axis = along / length
    not_parallel = [0.0, 1.0, 0.0] if abs(axis[1]) < 0.9 else [1.0, 0.0, 0.0]
    side = np.cross(not_parallel, axis)
    side /= np.linalg.norm(side)
    pose = np.eye(4)
    start = np.asarray(low, dtype=float)
    pose[:3] = np.stack([side, np.cross(axis, side), axis, start], axis=1)
    return replace(shapes.transformed(bar, pose), uv=np.asarray(bar.uv) * [0.2, length])


def _legs(
    width: float, depth: float, height: float, thick: float, inset: float, rounded: bool
) -> Mesh:
    """Four legs, cylindrical and slanted if `rounded`, `inset` from the edges of width x depth."""
    half_x, half_y = width / 2 - inset, depth / 2 - inset
    places = [(x, y) for x in (-half_x, half_x) for y in (-half_y, half_y)]
    legs = [board((thick, thick, height), (x, y, height / 2)) for x, y in places]
    if rounded:
        legs = [
            rod([x, y, 0], [0.94 * x, 0.94 * y, height], thick / 2) for x, y in places
        ]
    return shapes.merged(legs)


def _table(
    rng: Rng,
    width: Range,
    depth: Range | None,
    height: Range | float,
    kind: str = "table",
) -> Piece:
    """A table, square without a `depth`."""
    w = rng.uniform(*width)
    d = w if depth is None else rng.uniform(*depth)
    h = height if isinstance(height, float) else rng.uniform(*height)
    thick, rounded = rng.uniform(0.025, 0.05), rng.random() < 0.5
    if rng.random() < 0.3:
        top = _round_top(d / 2, thick, h)
        w, shelf_size = d, (0.66 * d, 0.66 * d)
    else:
        top = board((w, d, thick), (0, 0, h - thick / 2), min(0.01, thick / 3))
        shelf_size = (0.92 * w, 0.9 * d)
    frame = _legs(0.85 * w, 0.85 * d, h - thick, rng.uniform(0.03, 0.06), 0.03, rounded)
    parts = (
        ("table-top", top, "wood"),
        ("table-legs", frame, one_of(rng, ["wood", "metal", "paint"])),
    )
    return Piece(kind, parts, (w, d), h, (Shelf((0, 0), h, shelf_size),))


def _round_top(radius: float, thick: float, height: float) -> Mesh:
    """A disc whose upper side is at `height`; (u, v) are its (x, y)."""
    profile = hard_edged([(0, 0), (radius, 0), (radius, thick), (0, thick)])
    disc = shapes.lathe(profile, 64, smooth=False)
    vertices = disc.vertices + np.array([0, 0, height - thick])
    return Mesh(vertices, disc.faces, disc.normals, disc.vertices[:, :2].copy())


def chair(rng: Rng) -> Piece:
    """A chair with slats or a panel as its back."""
    w, d = rng.uniform(0.42, 0.48), rng.uniform(0.42, 0.48)
    seat, back = 0.45, rng.uniform(0.8, 0.98)  # heights
    frame = [_legs(w, d, seat, 0.035, 0.02, False)]
    sides = (0.02 - w / 2, w / 2 - 0.02)
    frame += [
        rod([x, d / 2 - 0.02, seat], [0.98 * x, d / 2 + 0.05, back], 0.017)
        for x in sides
    ]
    if rng.random() < 0.5:
        for height in np.linspace(seat + 0.12, back - 0.03, 4):
            lean = 0.07 * (height - seat) / (back - seat)
            middle = (0, d / 2 - 0.02 + lean, float(height))
            frame.append(board((w - 0.06, 0.015, 0.05), middle))
    else:
        middle = (0, d / 2 + 0.03, back - 0.12)
        frame.append(board((w - 0.04, 0.02, 0.3), middle, 0.008))
    cushion = board((w, d, 0.05), (0, 0, seat + 0.02), 0.02)
    material = one_of(rng, ["wood", "paint"])
    parts = (
        ("chair", shapes.merged(frame), material),
        ("seat", cushion, one_of(rng, ["fabric", material])),
    )
    return Piece("chair", parts, (w, d + 0.08), back)


def _sofa(rng: Rng, seats: int = 0) -> Piece:
    """A sofa of 2 or 3 seats unless `seats` is given."""
    seats = seats or int(rng.integers(2, 4))
    seat = rng.uniform(0.58, 0.7)  # its width
    arm = rng.uniform(0.12, 0.22)
    depth = rng.uniform(0.8, 0.95)
    width = seats * seat + 2 * arm
    high, low = rng.uniform(0.72, 0.86), rng.uniform(0.4, 0.46)
    at_back = (0, depth / 2 - 0.1, 0.5 * (high + 0.14))
    body = [
        board((width, depth, 0.24), (0, 0, 0.24), 0.05),
        board((width, 0.2, high - 0.14), at_back, 0.07),
    ]
    for sign in (-1, 1):
        x = sign * (width - arm) / 2
        body.append(board((arm, depth, 0.44), (x, 0, 0.36), 0.05))
    cushions = []
    for i in range(seats):
        x = (i - (seats - 1) / 2) * seat
        on_seat = (x, -0.09, low - 0.03)
        cushions.append(board((seat - 0.015, depth - 0.22, 0.15), on_seat, 0.05))
        behind = (x, depth / 2 - 0.26, 0.5 * (high + low) + 0.02)
        cushions.append(board((seat - 0.02, 0.16, high - low), behind, 0.065))
    parts = [
        ("sofa", shapes.merged(body), "fabric"),
        ("cushions", shapes.merged(cushions), "fabric"),
        ("feet", _legs(0.92 * width, 0.85 * depth, 0.13, 0.05, 0.0, False), "wood"),
    ]
    for i in range(int(rng.integers(0, 4))):
        side = rng.uniform(0.36, 0.46)
        backwards = rotation([1, 0, 0], -rng.uniform(12, 24))
        lean = backwards @ rotation([0, 1, 0], rng.uniform(-15, 15))
        x = rng.uniform(-0.5, 0.5) * (width - 2 * arm - side)
        pose = translation([x, depth / 2 - 0.43, low + 0.07 + side / 2]) @ lean
        extents = np.array([side, 0.13, side])
        pillow = shapes.rounded_box(extents, 0.06, 3, tile=side)
        parts.append((f"pillow-{i}", shapes.transformed(pillow, pose), "pattern"))
    kind = "sofa" if seats > 1 else "armchair"
    return Piece(kind, tuple(parts), (width, depth), high)


def _bookcase(rng: Rng) -> Piece:
    width = rng.uniform(0.7, 1.3)
    height = rng.uniform(1.2, 2.1)
    depth = rng.uniform(0.28, 0.34)
    thick = 0.025
    inside = width - 2 * thick
    count = max(3, round(height / 0.36))
    levels = np.linspace(0.05, height - thick, count + 1)
    boards = []
    for sign in (-1, 1):
        side = (sign * (width - thick) / 2, 0, height / 2)
        boards.append(board((thick, depth, height), side))
    boards += [
        board((inside, depth, thick), (0, 0, float(level) + thick / 2))
        for level in levels
    ]
    back = (0, depth / 2 - 0.004, height / 2 + 0.02)
    boards.append(board((inside, 0.008, height - 0.05), back))

    size = (0.85 * width, 0.7 * depth)
    shelves, books = [Shelf((0.0, 0.0), height, size, 0.4)], []
    for low, high in pairwise(levels):
        free = float(high - low) - thick
        floor = float(low) + thick
        if rng.random() < 0.3:
            shelves.append(Shelf((0.0, -0.02), floor, size, 0.85 * free))
        else:
            books.append(_books(rng, inside, depth, floor, free))
    parts = [
        ("bookcase", shapes.merged(boards), one_of(rng, ["wood", "paint", "white"]))
    ]
    if books:
        parts.append(("books", shapes.merged(books), "spines"))
    return Piece("bookcase", tuple(parts), (width, depth), height, tuple(shelves))


def _books(rng: Rng, width: float, depth: float, low: float, free: float) -> Mesh:
    """A row of books; u selects a book's column of the texture."""
    x, books = -width / 2 + 0.005, []
    end = width / 2 * rng.uniform(0.2, 1.0)
    while x < end - 0.06:
        thick = rng.uniform(0.015, 0.05)
        tall = free * rng.uniform(0.62, 0.93)
        deep = depth * rng.uniform(0.6, 0.8)
        y = -depth / 2 + deep / 2 + rng.uniform(0.01, 0.04)
        book = board((thick - 0.001, deep, tall), (x + thick / 2, y, low + tall / 2))
        u = np.full(len(book.vertices), (int(rng.integers(32)) + 0.5) / 32)
        v = (book.vertices[:, 2] - low) / free
        books.append(replace(book, uv=np.column_stack([u, v])))
        x += thick
    return shapes.merged(books)


def _sideboard(rng: Rng) -> Piece:
    width = rng.uniform(0.9, 1.7)
    depth = rng.uniform(0.38, 0.46)
    height = rng.uniform(0.6, 0.9)
    foot = 0.12
    body = board((width, depth, height - foot), (0, 0, 0.5 * (height + foot)), 0.012)
    columns, rows = int(rng.integers(2, 5)), int(rng.integers(1, 4))
    fronts, knobs = [], []
    w, h = (width - 0.04) / columns, (height - foot - 0.05) / rows
    for i in range(columns):
        for j in range(rows):
            x, z = (i - (columns - 1) / 2) * w, foot + 0.025 + (j + 0.5) * h
            front = (x, -depth / 2 - 0.008, z)
            fronts.append(board((w - 0.014, 0.02, h - 0.014), front, 0.005))
            base, end = [x, -depth / 2 - 0.015, z], [x, -depth / 2 - 0.045, z]
            knobs.append(rod(base, end, 0.013))
    material = one_of(rng, ["wood", "paint", "white"])
    of_doors = one_of(rng, [material, material, "paint"])
    rounded = rng.random() < 0.5
    feet = _legs(0.94 * width, 0.86 * depth, foot, 0.045, 0.0, rounded)
    parts = (
        ("sideboard", body, material),
        ("doors", shapes.merged(fronts), of_doors),
        ("knobs", shapes.merged(knobs), "metal"),
        ("feet", feet, "wood"),
    )
    top = Shelf((0, 0.02), height, (0.9 * width, 0.75 * depth), 0.6)
    return Piece("sideboard", parts, (width, depth + 0.06), height, (top,))


def _plant(rng: Rng) -> Piece:
    r, tall = rng.uniform(0.13, 0.2), rng.uniform(0.24, 0.36)
    profile = [
        (0, 0),
        (0.75 * r, 0),
        (0.75 * r, 0),
        (r, tall),
        (r, tall),
        (0.88 * r, tall),
        (0.88 * r, tall),
        (0.85 * r, tall - 0.04),
        (0, tall - 0.03),
    ]
    pot = shapes.lathe(np.array(profile), 40, smooth=False)
    count = int(rng.integers(14, 28))
    long = rng.uniform(0.45, 0.8)
    wide = rng.uniform(0.05, 0.12)
    leaves = [_leaf(rng, long, wide, tall - 0.03) for _ in range(count)]
    parts = (("pot", pot, "glaze"), ("leaves", shapes.merged(leaves), "leaf"))
    return Piece("plant", parts, (0.8 * long, 0.8 * long), tall + 0.9 * long)


def _leaf(rng: Rng, long: float, wide: float, base: float) -> Mesh:
    """A leaf of three rows of vertices, its ridge below its edges, that rises from z = `base` and droops."""
    turn = rng.uniform(0, 2 * math.pi)
    rise = rng.uniform(0.6, 1.35)
    droop = rng.uniform(0.6, 1.8)
    long *= rng.uniform(0.6, 1.0)
    # The ridge, in steps of equal length at the angle `slope` above the horizon.
    t = np.linspace(0, 1, 9)
    slope = rise - droop * t**1.5
    out = np.concatenate([[0], np.cumsum(np.cos(slope[:-1]))]) * long / 8
    up = np.concatenate([[0], np.cumsum(np.sin(slope[:-1]))]) * long / 8
    ridge = np.stack([out * math.cos(turn), out * math.sin(turn), base + up], axis=-1)

    half = wide * np.sin(np.pi * np.clip(0.08 + 0.92 * t, 0, 1)) ** 0.8
    across = np.array([-math.sin(turn), math.cos(turn), 0.0])
    rows = np.array([-1.0, 0.0, 1.0])
    points = ridge[:, None] + half[:, None, None] * rows[:, None] * across
    points[:, 1, 2] -= 0.25 * half
    u, v = np.broadcast_arrays(np.array([0.0, 0.5, 1.0]) * 0.2, t[:, None])
    uv = np.stack([u, v], axis=-1).reshape(-1, 2)
    vertices, faces = points.reshape(-1, 3), shapes.grid(3, 9)
    tangent = np.gradient(ridge, axis=0)
    normal = np.cross(np.broadcast_to(across, tangent.shape), tangent)
    normal = -normal / np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.repeat(normal, 3, axis=0)
    if shapes.face_cross(vertices, faces).sum(axis=0) @ normal.sum(axis=0) < 0:
        faces = faces[:, ::-1]
    return double_sided(vertices, faces, normal, uv, 1e-4)


def _floor_lamp(rng: Rng) -> Piece:
    tall = rng.uniform(1.35, 1.65)
    base = rod([0, 0, 0], [0, 0, 0.025], 0.15)
    stand = shapes.merged([base, rod([0, 0, 0.02], [0, 0, tall], 0.011)])
    low, high = rng.uniform(0.17, 0.25), rng.uniform(0.1, 0.17)
    shade = shapes.lathe(np.array([(low, 0), (high, 0.28)]), 40, smooth=False)
    shade = shapes.transformed(shade, translation([0, 0, tall - 0.12]))
    parts = (("lamp", stand, "metal"), ("shade", shade, "lit"))
    return Piece("lamp", parts, (0.4, 0.4), tall + 0.16)


def _crate(rng: Rng) -> Piece:
    w, d, h = rng.uniform(0.3, 0.55), rng.uniform(0.28, 0.45), rng.uniform(0.2, 0.45)
    box = board((w, d, h), (0, 0, h / 2), 0.008)
    parts = (("box", box, one_of(rng, ["wood", "card", "pattern"])),)
    top = Shelf((0, 0), h, (0.9 * w, 0.9 * d))
    return Piece("box", parts, (w, d), h, (top,))


Maker = Callable[[Rng], Piece]
AGAINST_WALLS: dict[str, Maker] = {
    "sofa": _sofa,
    "bookcase": _bookcase,
    "sideboard": _sideboard,
    "armchair": partial(_sofa, seats=1),
    "plant": _plant,
    "lamp": _floor_lamp,
}
IN_THE_MIDDLE: tuple[Maker, ...] = (
    partial(_table, width=(0.8, 1.2), depth=(0.5, 0.75), height=(0.36, 0.46)),
    partial(_table, width=(1.2, 1.7), depth=(0.75, 0.95), height=DINING_HEIGHT),
)
IN_FRONT: tuple[Maker, ...] = (
    partial(_table, width=(0.42, 0.55), depth=None, height=(0.5, 0.7)),
    partial(_table, width=(0.34, 0.4), depth=None, height=(0.44, 0.62), kind="stool"),
    chair,
    _crate,
    _plant,
)
