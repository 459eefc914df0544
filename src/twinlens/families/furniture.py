"""Furniture built of boards, cushions and turned legs: parts around the middle of their foot on the floor, front to -y.

A `Piece` knows its parts, each a mesh with (u, v) in metres and a word for its material, how much floor it takes, and
the level places on it where clutter may stand.
"""

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
    return Mesh(moved.vertices, moved.faces, moved.normals, np.asarray(moved.uv) * [0.2, length])


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
        top = Mesh(top.vertices + np.array([0, 0, height - thick]), top.faces, top.normals, top.vertices[:, :2].copy())
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
    sides = (0.02 - w / 2, w / 2 - 0.02)
    frame += [rod(np.array([x, d / 2 - 0.02, seat]), np.array([0.98 * x, d / 2 + 0.05, back]), 0.017) for x in sides]
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
    body += [board((arm, depth, 0.44), (side * (width - arm) / 2, 0, 0.36), 0.05) for side in (-1, 1)]
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
    pillows = [_pillow(rng, width - 2 * arm, depth, low) for _ in range(int(rng.integers(0, 4)))]
    parts += [(f"pillow-{i}", pillow, "pattern") for i, pillow in enumerate(pillows)]
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
