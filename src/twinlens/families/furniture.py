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
    box = (
        shapes.rounded_box(size, radius, 3, tile=1.0)
        if radius > 0
        else shapes.box(size, tile=1.0)
    )
    return shapes.transformed(box, translation(middle))


def rod(low: ArrayLike, high: ArrayLike, radius: float) -> Mesh:
    """A cylinder between the middles (3,) of its ends."""
    along = np.subtract(high, low)
    length = float(np.linalg.norm(along))
    bar = shapes.lathe(
        hard_edged([(0, 0), (radius, 0), (radius, length), (0, length)]),
        18,
        smooth=False,
    )
    axis = along / length
    side = np.cross([0.0, 1.0, 0.0] if abs(axis[1]) < 0.9 else [1.0, 0.0, 0.0], axis)
    side /= np.linalg.norm(side)
    pose = np.eye(4)
    pose[:3] = np.stack(
        [side, np.cross(axis, side), axis, np.asarray(low, dtype=float)], axis=1
    )
    return replace(shapes.transformed(bar, pose), uv=np.asarray(bar.uv) * [0.2, length])


def _legs(
    width: float, depth: float, height: float, thick: float, inset: float, rounded: bool
) -> Mesh:
    """Four legs, cylindrical and slanted if `rounded`, `inset` from the edges of width x depth."""
    half_x, half_y = width / 2 - inset, depth / 2 - inset
    places = [(x, y) for x in (-half_x, half_x) for y in (-half_y, half_y)]
    if rounded:
        return shapes.merged(
            [rod([x, y, 0], [0.94 * x, 0.94 * y, height], thick / 2) for x, y in places]
        )
    return shapes.merged(
        [board((thick, thick, height), (x, y, height / 2)) for x, y in places]
    )


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
        r = d / 2
        top = shapes.lathe(
            hard_edged([(0, 0), (r, 0), (r, thick), (0, thick)]), 64, smooth=False
        )
        top = Mesh(
            top.vertices + np.array([0, 0, h - thick]),
            top.faces,
            top.normals,
            top.vertices[:, :2].copy(),
        )
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


def chair(rng: Rng) -> Piece:
    """A chair with slats or a panel as its back."""
    w, d, seat, back = (
        rng.uniform(0.42, 0.48),
        rng.uniform(0.42, 0.48),
        0.45,
        rng.uniform(0.8, 0.98),
    )
    frame = [_legs(w, d, seat, 0.035, 0.02, False)]
    sides = (0.02 - w / 2, w / 2 - 0.02)
    frame += [
        rod([x, d / 2 - 0.02, seat], [0.98 * x, d / 2 + 0.05, back], 0.017)
        for x in sides
    ]
    if rng.random() < 0.5:
        for height in np.linspace(seat + 0.12, back - 0.03, 4):
            lean = 0.07 * (height - seat) / (back - seat)
            frame.append(
                board((w - 0.06, 0.015, 0.05), (0, d / 2 - 0.02 + lean, float(height)))
            )
    else:
        frame.append(
            board((w - 0.04, 0.02, 0.3), (0, d / 2 + 0.03, back - 0.12), 0.008)
        )
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
    seat, arm, depth = (
        rng.uniform(0.58, 0.7),
        rng.uniform(0.12, 0.22),
        rng.uniform(0.8, 0.95),
    )
    width = seats * seat + 2 * arm
    high, low = rng.uniform(0.72, 0.86), rng.uniform(0.4, 0.46)
    body = [
        board((width, depth, 0.24), (0, 0, 0.24), 0.05),
        board(
            (width, 0.2, high - 0.14), (0, depth / 2 - 0.1, 0.5 * (high + 0.14)), 0.07
        ),
    ]
    body += [
        board((arm, depth, 0.44), (side * (width - arm) / 2, 0, 0.36), 0.05)
        for side in (-1, 1)
    ]
    cushions = []
    for i in range(seats):
        x = (i - (seats - 1) / 2) * seat
        cushions.append(
            board((seat - 0.015, depth - 0.22, 0.15), (x, -0.09, low - 0.03), 0.05)
        )
        cushions.append(
            board(
                (seat - 0.02, 0.16, high - low),
                (x, depth / 2 - 0.26, 0.5 * (high + low) + 0.02),
                0.065,
            )
        )
    parts = [
        ("sofa", shapes.merged(body), "fabric"),
        ("cushions", shapes.merged(cushions), "fabric"),
        ("feet", _legs(0.92 * width, 0.85 * depth, 0.13, 0.05, 0.0, False), "wood"),
    ]
    for i in range(int(rng.integers(0, 4))):
        side = rng.uniform(0.36, 0.46)
        lean = rotation([1, 0, 0], -rng.uniform(12, 24)) @ rotation(
            [0, 1, 0], rng.uniform(-15, 15)
        )
        x = rng.uniform(-0.5, 0.5) * (width - 2 * arm - side)
        pose = translation([x, depth / 2 - 0.43, low + 0.07 + side / 2]) @ lean
        pillow = shapes.transformed(
            shapes.rounded_box(np.array([side, 0.13, side]), 0.06, 3, tile=side), pose
        )
        parts.append((f"pillow-{i}", pillow, "pattern"))
    return Piece(
        "sofa" if seats > 1 else "armchair", tuple(parts), (width, depth), high
    )


def _bookcase(rng: Rng) -> Piece:
    width, height, depth, thick = (
        rng.uniform(0.7, 1.3),
        rng.uniform(1.2, 2.1),
        rng.uniform(0.28, 0.34),
        0.025,
    )
    count = max(3, round(height / 0.36))
    levels = np.linspace(0.05, height - thick, count + 1)
    boards = [
        board((thick, depth, height), (s * (width - thick) / 2, 0, height / 2))
        for s in (-1, 1)
    ]
    boards += [
        board((width - 2 * thick, depth, thick), (0, 0, float(z) + thick / 2))
        for z in levels
    ]
    boards.append(
        board(
            (width - 2 * thick, 0.008, height - 0.05),
            (0, depth / 2 - 0.004, height / 2 + 0.02),
        )
    )
    shelves, books = [Shelf((0.0, 0.0), height, (0.85 * width, 0.7 * depth), 0.4)], []
    for low, high in pairwise(levels):
        free = float(high - low) - thick
        if rng.random() < 0.3:
            shelves.append(
                Shelf(
                    (0.0, -0.02),
                    float(low) + thick,
                    (0.85 * width, 0.7 * depth),
                    0.85 * free,
                )
            )
        else:
            books.append(
                _books(rng, width - 2 * thick, depth, float(low) + thick, free)
            )
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
        thick, tall, deep = (
            rng.uniform(0.015, 0.05),
            free * rng.uniform(0.62, 0.93),
            depth * rng.uniform(0.6, 0.8),
        )
        y = -depth / 2 + deep / 2 + rng.uniform(0.01, 0.04)
        book = board((thick - 0.001, deep, tall), (x + thick / 2, y, low + tall / 2))
        u = (int(rng.integers(32)) + 0.5) / 32
        uv = np.column_stack(
            [np.full(len(book.vertices), u), (book.vertices[:, 2] - low) / free]
        )
        books.append(replace(book, uv=uv))
        x += thick
    return shapes.merged(books)


def _sideboard(rng: Rng) -> Piece:
    width, depth, height, foot = (
        rng.uniform(0.9, 1.7),
        rng.uniform(0.38, 0.46),
        rng.uniform(0.6, 0.9),
        0.12,
    )
    body = board((width, depth, height - foot), (0, 0, 0.5 * (height + foot)), 0.012)
    columns, rows = int(rng.integers(2, 5)), int(rng.integers(1, 4))
    fronts, knobs = [], []
    w, h = (width - 0.04) / columns, (height - foot - 0.05) / rows
    for i in range(columns):
        for j in range(rows):
            x, z = (i - (columns - 1) / 2) * w, foot + 0.025 + (j + 0.5) * h
            fronts.append(
                board((w - 0.014, 0.02, h - 0.014), (x, -depth / 2 - 0.008, z), 0.005)
            )
            knobs.append(
                rod([x, -depth / 2 - 0.015, z], [x, -depth / 2 - 0.045, z], 0.013)
            )
    material = one_of(rng, ["wood", "paint", "white"])
    parts = (
        ("sideboard", body, material),
        ("doors", shapes.merged(fronts), one_of(rng, [material, material, "paint"])),
        ("knobs", shapes.merged(knobs), "metal"),
        (
            "feet",
            _legs(0.94 * width, 0.86 * depth, foot, 0.045, 0.0, rng.random() < 0.5),
            "wood",
        ),
    )
    top = Shelf((0, 0.02), height, (0.9 * width, 0.75 * depth), 0.6)
    return Piece("sideboard", parts, (width, depth + 0.06), height, (top,))


def _plant(rng: Rng) -> Piece:
    r, tall = rng.uniform(0.13, 0.2), rng.uniform(0.24, 0.36)
    profile = [(0, 0), (0.75 * r, 0), (0.75 * r, 0), (r, tall), (r, tall), (0.88 * r, tall), (0.88 * r, tall),
               (0.85 * r, tall - 0.04), (0, tall - 0.03)]  # fmt: skip
    pot = shapes.lathe(np.array(profile), 40, smooth=False)
    count, long, wide = (
        int(rng.integers(14, 28)),
        rng.uniform(0.45, 0.8),
        rng.uniform(0.05, 0.12),
    )
    leaves = [_leaf(rng, long, wide, tall - 0.03) for _ in range(count)]
    parts = (("pot", pot, "glaze"), ("leaves", shapes.merged(leaves), "leaf"))
    return Piece("plant", parts, (0.8 * long, 0.8 * long), tall + 0.9 * long)


def _leaf(rng: Rng, long: float, wide: float, base: float) -> Mesh:
    turn, rise, droop = (
        rng.uniform(0, 2 * math.pi),
        rng.uniform(0.6, 1.35),
        rng.uniform(0.6, 1.8),
    )
    long *= rng.uniform(0.6, 1.0)
    t = np.linspace(0, 1, 9)
    angle = rise - droop * t**1.5
    out, up = (
        np.concatenate([[0], np.cumsum(f(angle[:-1]))]) * long / 8
        for f in (np.cos, np.sin)
    )
    half = wide * np.sin(np.pi * np.clip(0.08 + 0.92 * t, 0, 1)) ** 0.8
    ridge = np.stack([out * math.cos(turn), out * math.sin(turn), base + up], axis=-1)
    across = np.array([-math.sin(turn), math.cos(turn), 0.0])
    points = (
        ridge[:, None]
        + half[:, None, None] * np.array([-1.0, 0.0, 1.0])[:, None] * across
    )
    points[:, 1, 2] -= 0.25 * half
    uv = np.stack(
        np.broadcast_arrays(np.array([0.0, 0.5, 1.0]) * 0.2, t[:, None]), axis=-1
    ).reshape(-1, 2)
    vertices, faces = points.reshape(-1, 3), shapes.grid(3, 9)
    tangent = np.gradient(ridge, axis=0)
    normal = np.cross(np.broadcast_to(across, tangent.shape), tangent)
    normal = np.repeat(
        -normal / np.linalg.norm(normal, axis=1, keepdims=True), 3, axis=0
    )
    if shapes.face_cross(vertices, faces).sum(axis=0) @ normal.sum(axis=0) < 0:
        faces = faces[:, ::-1]
    return double_sided(vertices, faces, normal, uv, 1e-4)


def _floor_lamp(rng: Rng) -> Piece:
    tall = rng.uniform(1.35, 1.65)
    stand = shapes.merged(
        [rod([0, 0, 0], [0, 0, 0.025], 0.15), rod([0, 0, 0.02], [0, 0, tall], 0.011)]
    )
    low, high = rng.uniform(0.17, 0.25), rng.uniform(0.1, 0.17)
    shade = shapes.lathe(np.array([(low, 0), (high, 0.28)]), 40, smooth=False)
    shade = shapes.transformed(shade, translation([0, 0, tall - 0.12]))
    return Piece(
        "lamp",
        (("lamp", stand, "metal"), ("shade", shade, "lit")),
        (0.4, 0.4),
        tall + 0.16,
    )


def _crate(rng: Rng) -> Piece:
    w, d, h = rng.uniform(0.3, 0.55), rng.uniform(0.28, 0.45), rng.uniform(0.2, 0.45)
    parts = (
        (
            "box",
            board((w, d, h), (0, 0, h / 2), 0.008),
            one_of(rng, ["wood", "card", "pattern"]),
        ),
    )
    return Piece("box", parts, (w, d), h, (Shelf((0, 0), h, (0.9 * w, 0.9 * d)),))


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
