"""Furniture built of boards, cushions and turned legs: parts around the middle of their foot on the floor, front to -y.

A `Piece` knows its parts, each a mesh with (u, v) in metres and a word for its material, how much floor it takes, and
the level places on it where clutter may stand.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from twinlens.geometry import Float
from twinlens.scenes import shapes
from twinlens.scenes.placement import translation
from twinlens.scenes.scene import Mesh

Rng = np.random.Generator


@dataclass(frozen=True, eq=False)
class Shelf:
    """A level rectangle for clutter: middle (x, y), height, size (x, y), and the free height above it, metres."""

    middle: tuple[float, float]
    height: float
    size: tuple[float, float]
    free: float = 1.0


@dataclass(frozen=True, eq=False)
class Piece:
    """Parts as (name, mesh, material word), the floor it takes (x, y) in metres, its height, and its shelves."""

    kind: str
    parts: tuple[tuple[str, Mesh, str], ...]
    floor: tuple[float, float]
    height: float
    shelves: tuple[Shelf, ...] = ()


def board(extents: tuple[float, float, float], middle: tuple[float, float, float], radius: float = 0.0) -> Mesh:
    """A box or, with a radius, a cushion."""
    size = np.array(extents)
    made = shapes.rounded_box(size, radius, 3, tile=1.0) if radius > 0 else shapes.box(size, tile=1.0)
    return shapes.transformed(made, translation(np.array(middle)))


def rod(low: Float, high: Float, radius: float) -> Mesh:
    """A round bar between two points."""
    length = float(np.linalg.norm(np.subtract(high, low)))
    profile = np.array([(0, 0), (radius, 0), (radius, 0), (radius, length), (radius, length), (0, length)], dtype=float)
    bar = shapes.lathe(profile, 18, smooth=False)
    axis = np.subtract(high, low) / length
    side = np.cross([0.0, 1.0, 0.0] if abs(axis[1]) < 0.9 else [1.0, 0.0, 0.0], axis)
    side /= np.linalg.norm(side)
    pose = np.eye(4)
    pose[:3] = np.stack([side, np.cross(axis, side), axis, np.asarray(low, dtype=float)], axis=1)
    moved = shapes.transformed(bar, pose)
    return Mesh(moved.vertices, moved.faces, moved.normals, (moved.uv if moved.uv is not None else 0) * [0.2, length])


def legs(width: float, depth: float, height: float, thick: float, inset: float, rounded: bool) -> Mesh:
    """Four of them."""
    made = []
    for sx in (-1, 1):
        for sy in (-1, 1):
            x, y = sx * (width / 2 - inset), sy * (depth / 2 - inset)
            if rounded:
                made.append(rod(np.array([x, y, 0]), np.array([0.94 * x, 0.94 * y, height]), thick / 2))
            else:
                made.append(board((thick, thick, height), (x, y, height / 2)))
    return shapes.merged(made)


def table(rng: Rng, size: tuple[float, float], height: float) -> Piece:
    """A top on four legs, square or round."""
    width, depth = size
    thick, rounded = rng.uniform(0.025, 0.05), rng.random() < 0.5
    if rng.random() < 0.3:
        r = depth / 2
        profile = np.array([(0, 0), (r, 0), (r, 0), (r, thick), (r, thick), (0, thick)])
        top = shapes.lathe(profile, 64, smooth=False)
        top = Mesh(top.vertices + [0, 0, height - thick], top.faces, top.normals, top.vertices[:, :2].copy())
        width, shelf = depth, (0.66 * depth, 0.66 * depth)
    else:
        top = board((width, depth, thick), (0, 0, height - thick / 2), min(0.01, thick / 3))
        shelf = (0.92 * width, 0.9 * depth)
    frame = legs(0.85 * width, 0.85 * depth, height - thick, rng.uniform(0.03, 0.06), 0.03, rounded)
    parts = (("table-top", top, "wood"), ("table-legs", frame, str(rng.choice(["wood", "metal", "paint"]))))
    return Piece("table", parts, (width, depth), height, (Shelf((0, 0), height, shelf),))


def coffee_table(rng: Rng) -> Piece:
    """Low and wide."""
    return table(rng, (rng.uniform(0.8, 1.2), rng.uniform(0.5, 0.75)), rng.uniform(0.36, 0.46))


def dining_table(rng: Rng) -> Piece:
    """High and large."""
    return table(rng, (rng.uniform(1.2, 1.7), rng.uniform(0.75, 0.95)), 0.74)


def side_table(rng: Rng) -> Piece:
    """Small and high."""
    side = rng.uniform(0.42, 0.55)
    return table(rng, (side, side), rng.uniform(0.5, 0.7))


def stool(rng: Rng) -> Piece:
    """A round seat on four legs."""
    side = rng.uniform(0.34, 0.4)
    made = table(rng, (side, side), rng.uniform(0.44, 0.62))
    return Piece("stool", made.parts, made.floor, made.height, made.shelves)


def chair(rng: Rng) -> Piece:
    """Seat, legs and back, with slats or a panel."""
    w, d, seat, back = rng.uniform(0.42, 0.48), rng.uniform(0.42, 0.48), 0.45, rng.uniform(0.8, 0.98)
    frame = [legs(w, d, seat, 0.035, 0.02, False)]
    for sx in (-1, 1):
        frame.append(
            rod(
                np.array([sx * (w / 2 - 0.02), d / 2 - 0.02, seat]),
                np.array([sx * (w / 2 - 0.03), d / 2 + 0.05, back]),
                0.017,
            )
        )
    if rng.random() < 0.5:
        for height in np.linspace(seat + 0.12, back - 0.03, 4):
            lean = 0.07 * (height - seat) / (back - seat)
            frame.append(board((w - 0.06, 0.015, 0.05), (0, d / 2 - 0.02 + lean, float(height))))
    else:
        frame.append(board((w - 0.04, 0.02, 0.3), (0, d / 2 + 0.03, back - 0.12), 0.008))
    cushion = board((w, d, 0.05), (0, 0, seat + 0.02), 0.02)
    word = str(rng.choice(["wood", "paint"]))
    return Piece(
        "chair",
        (("chair", shapes.merged(frame), word), ("seat", cushion, str(rng.choice(["fabric", word])))),
        (w, d + 0.08),
        back,
    )


def sofa(rng: Rng, seats: int = 0) -> Piece:
    """Base, back, arms and cushions, all of one cloth or the cushions of another."""
    seats = seats or int(rng.integers(2, 4))
    seat, arm, depth = rng.uniform(0.58, 0.7), rng.uniform(0.12, 0.22), rng.uniform(0.8, 0.95)
    width = seats * seat + 2 * arm
    high, low = rng.uniform(0.72, 0.86), rng.uniform(0.4, 0.46)
    body = [
        board((width, depth, 0.24), (0, 0, 0.24), 0.05),
        board((width, 0.2, high - 0.14), (0, depth / 2 - 0.1, 0.5 * (high + 0.14)), 0.07),
    ]
    for side in (-1, 1):
        body.append(board((arm, depth, 0.44), (side * (width - arm) / 2, 0, 0.36), 0.05))
    cushions = []
    for i in range(seats):
        x = (i - (seats - 1) / 2) * seat
        cushions.append(board((seat - 0.015, depth - 0.22, 0.15), (x, -0.09, low - 0.03), 0.05))
        cushions.append(board((seat - 0.02, 0.16, high - low), (x, depth / 2 - 0.26, 0.5 * (high + low) + 0.02), 0.065))
    feet = legs(0.92 * width, 0.85 * depth, 0.13, 0.05, 0.0, False)
    parts = [
        ("sofa", shapes.merged(body), "fabric"),
        ("cushions", shapes.merged(cushions), "fabric"),
        ("feet", feet, "wood"),
    ]
    for i in range(int(rng.integers(0, 4))):
        parts.append((f"pillow-{i}", _pillow(rng, width - 2 * arm, depth, low), "pattern"))
    return Piece("sofa" if seats > 1 else "armchair", tuple(parts), (width, depth), high)


def _pillow(rng: Rng, width: float, depth: float, low: float) -> Mesh:
    """Leaning against the back."""
    from twinlens.scenes.placement import rotation

    side = rng.uniform(0.36, 0.46)
    made = shapes.rounded_box(np.array([side, 0.13, side]), 0.06, 3, tile=side)
    lean = rotation(np.array([1.0, 0, 0]), -rng.uniform(12, 24)) @ rotation(np.array([0, 1.0, 0]), rng.uniform(-15, 15))
    x = rng.uniform(-0.5, 0.5) * (width - side)
    return shapes.transformed(made, translation(np.array([x, depth / 2 - 0.43, low + 0.07 + side / 2])) @ lean)


def armchair(rng: Rng) -> Piece:
    """A sofa for one."""
    return sofa(rng, 1)


def bookcase(rng: Rng) -> Piece:
    """Boards with rows of books, some bays left for other things."""
    width, height, depth, thick = rng.uniform(0.7, 1.3), rng.uniform(1.2, 2.1), rng.uniform(0.28, 0.34), 0.025
    count = max(3, round(height / 0.36))
    levels = np.linspace(0.05, height - thick, count + 1)
    boards = [board((thick, depth, height), (s * (width - thick) / 2, 0, height / 2)) for s in (-1, 1)]
    boards += [board((width - 2 * thick, depth, thick), (0, 0, float(z) + thick / 2)) for z in levels]
    boards.append(board((width - 2 * thick, 0.008, height - 0.05), (0, depth / 2 - 0.004, height / 2 + 0.02)))
    shelves, books = [Shelf((0.0, 0.0), height, (0.85 * width, 0.7 * depth), 0.4)], []
    for low, high in zip(levels[:-1], levels[1:], strict=True):
        free = float(high - low) - thick
        if rng.random() < 0.3:
            shelves.append(Shelf((0.0, -0.02), float(low) + thick, (0.85 * width, 0.7 * depth), 0.85 * free))
        else:
            books.append(_books(rng, width - 2 * thick, depth, float(low) + thick, free))
    parts = [("bookcase", shapes.merged(boards), str(rng.choice(["wood", "paint", "white"])))]
    if books:
        parts.append(("books", shapes.merged(books), "spines"))
    return Piece("bookcase", tuple(parts), (width, depth), height, tuple(shelves))


def _books(rng: Rng, width: float, depth: float, low: float, free: float) -> Mesh:
    """A row of spines; u tells the book: a column of the texture each."""
    x, made = -width / 2 + 0.005, []
    end = width / 2 * rng.uniform(0.2, 1.0)
    while x < end - 0.06:
        thick, tall, deep = rng.uniform(0.015, 0.05), free * rng.uniform(0.62, 0.93), depth * rng.uniform(0.6, 0.8)
        book = board(
            (thick - 0.001, deep, tall),
            (x + thick / 2, -depth / 2 + deep / 2 + rng.uniform(0.01, 0.04), low + tall / 2),
        )
        column = int(rng.integers(32))
        uv = np.column_stack([np.full(len(book.vertices), (column + 0.5) / 32), (book.vertices[:, 2] - low) / free])
        made.append(Mesh(book.vertices, book.faces, book.normals, uv))
        x += thick
    return shapes.merged(made)


def sideboard(rng: Rng) -> Piece:
    """A chest with doors or drawers, and room on top."""
    width, depth, height, foot = rng.uniform(0.9, 1.7), rng.uniform(0.38, 0.46), rng.uniform(0.6, 0.9), 0.12
    body = [board((width, depth, height - foot), (0, 0, 0.5 * (height + foot)), 0.012)]
    columns, rows = int(rng.integers(2, 5)), int(rng.integers(1, 4))
    fronts, knobs = [], []
    w, h = (width - 0.04) / columns, (height - foot - 0.05) / rows
    for i in range(columns):
        for j in range(rows):
            x, z = (i - (columns - 1) / 2) * w, foot + 0.025 + (j + 0.5) * h
            fronts.append(board((w - 0.014, 0.02, h - 0.014), (x, -depth / 2 - 0.008, z), 0.005))
            knobs.append(rod(np.array([x, -depth / 2 - 0.015, z]), np.array([x, -depth / 2 - 0.045, z]), 0.013))
    word = str(rng.choice(["wood", "paint", "white"]))
    parts = (
        ("sideboard", shapes.merged(body), word),
        ("doors", shapes.merged(fronts), str(rng.choice([word, word, "paint"]))),
        ("knobs", shapes.merged(knobs), "metal"),
        ("feet", legs(0.94 * width, 0.86 * depth, foot, 0.045, 0.0, rng.random() < 0.5), "wood"),
    )
    return Piece(
        "sideboard", parts, (width, depth + 0.06), height, (Shelf((0, 0.02), height, (0.9 * width, 0.75 * depth), 0.6),)
    )


def plant(rng: Rng) -> Piece:
    """A pot and arching leaves."""
    r, tall = rng.uniform(0.13, 0.2), rng.uniform(0.24, 0.36)
    pot = shapes.lathe(
        np.array(
            [
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
        ),
        40,
        smooth=False,
    )
    count, long, wide = int(rng.integers(14, 28)), rng.uniform(0.45, 0.8), rng.uniform(0.05, 0.12)
    leaves = [_leaf(rng, long, wide, tall - 0.03) for _ in range(count)]
    parts = (("pot", pot, "glaze"), ("leaves", shapes.merged(leaves), "leaf"))
    return Piece("plant", parts, (0.8 * long, 0.8 * long), tall + 0.9 * long)


def _leaf(rng: Rng, long: float, wide: float, base: float) -> Mesh:
    """A bent blade, both its faces."""
    turn, rise, droop = rng.uniform(0, 2 * math.pi), rng.uniform(0.6, 1.35), rng.uniform(0.6, 1.8)
    long *= rng.uniform(0.6, 1.0)
    t = np.linspace(0, 1, 9)
    angle = rise - droop * t**1.5
    out, up = (np.concatenate([[0], np.cumsum(f(angle[:-1]))]) * long / 8 for f in (np.cos, np.sin))
    half = wide * np.sin(np.pi * np.clip(0.08 + 0.92 * t, 0, 1)) ** 0.8
    ridge = np.stack([out * math.cos(turn), out * math.sin(turn), base + up], axis=-1)
    across = np.array([-math.sin(turn), math.cos(turn), 0.0])
    points = ridge[:, None] + half[:, None, None] * np.array([-1.0, 0.0, 1.0])[:, None] * across
    points[:, 1, 2] -= 0.25 * half
    uv = np.stack(np.broadcast_arrays(np.array([0.0, 0.5, 1.0]) * 0.2, t[:, None]), axis=-1).reshape(-1, 2)
    vertices, faces = points.reshape(-1, 3), shapes.grid(3, 9)
    tangent = np.gradient(ridge, axis=0)
    normal = np.cross(np.broadcast_to(across, tangent.shape), tangent)
    normal = np.repeat(-normal / np.linalg.norm(normal, axis=1, keepdims=True), 3, axis=0)
    cross = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
    if (cross.sum(axis=0) @ normal.sum(axis=0)) < 0:
        faces = faces[:, ::-1]
    return shapes.merged(
        [Mesh(vertices, faces, normal, uv), Mesh(vertices - 1e-4 * normal, faces[:, ::-1], -normal, uv)]
    )


def floor_lamp(rng: Rng) -> Piece:
    """Foot, pole and a lit shade."""
    tall = rng.uniform(1.35, 1.65)
    foot = rod(np.zeros(3), np.array([0, 0, 0.025]), 0.15)
    pole = rod(np.array([0, 0, 0.02]), np.array([0, 0, tall]), 0.011)
    low, high = rng.uniform(0.17, 0.25), rng.uniform(0.1, 0.17)
    shade = shapes.lathe(np.array([(low, 0), (high, 0.28)]), 40, smooth=False)
    shade = shapes.transformed(shade, translation(np.array([0, 0, tall - 0.12])))
    parts = (("lamp", shapes.merged([foot, pole]), "metal"), ("shade", shade, "lit"))
    return Piece("lamp", parts, (0.4, 0.4), tall + 0.16)


def parcel(rng: Rng) -> Piece:
    """A box or crate on the floor."""
    w, d, h = rng.uniform(0.3, 0.55), rng.uniform(0.28, 0.45), rng.uniform(0.2, 0.45)
    made = board((w, d, h), (0, 0, h / 2), 0.008)
    return Piece(
        "box",
        (("box", made, str(rng.choice(["wood", "card", "pattern"]))),),
        (w, d),
        h,
        (Shelf((0, 0), h, (0.9 * w, 0.9 * d)),),
    )


AGAINST_WALLS: dict[str, Callable[[Rng], Piece]] = {
    "sofa": sofa,
    "bookcase": bookcase,
    "sideboard": sideboard,
    "armchair": armchair,
    "plant": plant,
    "lamp": floor_lamp,
}
IN_THE_MIDDLE: dict[str, Callable[[Rng], Piece]] = {"coffee table": coffee_table, "dining table": dining_table}
IN_FRONT: dict[str, Callable[[Rng], Piece]] = {
    "side table": side_table,
    "stool": stool,
    "chair": chair,
    "armchair": armchair,
    "box": parcel,
    "plant": plant,
}
