"""Furniture: the origin is the middle of the footprint, the front faces -y, z is up. Lengths are in metres."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise, product

import numpy as np
from numpy.typing import ArrayLike

from twinlens.families.draws import Rng, one_of
from twinlens.families.solids import double_sided, hard_edged
from twinlens.geometry import Float
from twinlens.scenes import shapes
from twinlens.scenes.placement import rotation, translation
from twinlens.scenes.scene import Mesh

DINING_HEIGHT = 0.74  # metres
_SEAT = 0.45  # metres, the height of a chair's seat
_BOARD = 0.025  # metres, the thickness of a bookcase's boards
_FOOT = 0.12  # metres, the height of a sideboard's feet
_LEAF_STEPS = 8
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
    high = rng.uniform(0.8, 0.98)  # the upper end of its back
    legs = _legs(w, d, _SEAT, 0.035, 0.02, False)
    back = _chair_back(w, d, high, has_slats=rng.random() < 0.5)
    cushion = board((w, d, 0.05), (0, 0, _SEAT + 0.02), 0.02)
    material = one_of(rng, ["wood", "paint"])
    parts = (
        ("chair", shapes.merged([legs, *back]), material),
        ("seat", cushion, one_of(rng, ["fabric", material])),
    )
    return Piece("chair", parts, (w, d + 0.08), high)


def _chair_back(w: float, d: float, high: float, has_slats: bool) -> list[Mesh]:
    """Two posts that lean backwards, with four slats or one panel between them."""
    foot_y, top_y = d / 2 - 0.02, d / 2 + 0.05
    sides = (0.02 - w / 2, w / 2 - 0.02)
    back = [rod([x, foot_y, _SEAT], [0.98 * x, top_y, high], 0.017) for x in sides]
    if not has_slats:
        back.append(board((w - 0.04, 0.02, 0.3), (0, d / 2 + 0.03, high - 0.12), 0.008))
        return back
    for height in np.linspace(_SEAT + 0.12, high - 0.03, 4).tolist():
        lean = 0.07 * (height - _SEAT) / (high - _SEAT)
        back.append(board((w - 0.06, 0.015, 0.05), (0, foot_y + lean, height)))
    return back


@dataclass(frozen=True)
class _SofaSize:
    """Measures of a sofa in metres: of a seat and an arm along x, heights of the back and of the seats."""

    seats: int
    seat: float
    arm: float
    depth: float
    high: float
    low: float

    @property
    def width(self) -> float:
        return self.seats * self.seat + 2 * self.arm


def _sofa(rng: Rng, seats: int = 0) -> Piece:
    """A sofa of 2 or 3 seats unless `seats` is given."""
    size = _SofaSize(
        seats=seats or int(rng.integers(2, 4)),
        seat=rng.uniform(0.58, 0.7),
        arm=rng.uniform(0.12, 0.22),
        depth=rng.uniform(0.8, 0.95),
        high=rng.uniform(0.72, 0.86),
        low=rng.uniform(0.4, 0.46),
    )
    width, depth = size.width, size.depth
    feet = _legs(0.92 * width, 0.85 * depth, 0.13, 0.05, 0.0, False)
    parts = [
        ("sofa", _sofa_body(size), "fabric"),
        ("cushions", _sofa_cushions(size), "fabric"),
        ("feet", feet, "wood"),
    ]
    pillows = int(rng.integers(0, 4))
    parts += [(f"pillow-{i}", _pillow(rng, size), "pattern") for i in range(pillows)]
    kind = "sofa" if size.seats > 1 else "armchair"
    return Piece(kind, tuple(parts), (width, depth), size.high)


def _sofa_body(size: _SofaSize) -> Mesh:
    """Base, back and two arms."""
    width, depth = size.width, size.depth
    at_back = (0, depth / 2 - 0.1, 0.5 * (size.high + 0.14))
    body = [
        board((width, depth, 0.24), (0, 0, 0.24), 0.05),
        board((width, 0.2, size.high - 0.14), at_back, 0.07),
    ]
    for sign in (-1, 1):
        x = sign * (width - size.arm) / 2
        body.append(board((size.arm, depth, 0.44), (x, 0, 0.36), 0.05))
    return shapes.merged(body)


def _sofa_cushions(size: _SofaSize) -> Mesh:
    """A cushion on each seat, and one behind it."""
    seat, depth, high, low = size.seat, size.depth, size.high, size.low
    cushions = []
    for number in range(size.seats):
        x = (number - (size.seats - 1) / 2) * seat
        on_seat = (x, -0.09, low - 0.03)
        cushions.append(board((seat - 0.015, depth - 0.22, 0.15), on_seat, 0.05))
        behind = (x, depth / 2 - 0.26, 0.5 * (high + low) + 0.02)
        cushions.append(board((seat - 0.02, 0.16, high - low), behind, 0.065))
    return shapes.merged(cushions)


def _pillow(rng: Rng, size: _SofaSize) -> Mesh:
    """A pillow on a seat that leans against the back."""
    side = rng.uniform(0.36, 0.46)
    backwards = rotation([1, 0, 0], -rng.uniform(12, 24))
    lean = backwards @ rotation([0, 1, 0], rng.uniform(-15, 15))
    x = rng.uniform(-0.5, 0.5) * (size.width - 2 * size.arm - side)
    place = [x, size.depth / 2 - 0.43, size.low + 0.07 + side / 2]
    extents = np.array([side, 0.13, side])
    pillow = shapes.rounded_box(extents, 0.06, 3, tile=side)
    return shapes.transformed(pillow, translation(place) @ lean)


def _bookcase(rng: Rng) -> Piece:
    """A bookcase of 1.2 to 2.1 m: books on most of its shelves, the others free for objects."""
    width = rng.uniform(0.7, 1.3)
    height = rng.uniform(1.2, 2.1)
    depth = rng.uniform(0.28, 0.34)
    count = max(3, round(height / 0.36))
    levels = np.linspace(0.05, height - _BOARD, count + 1).tolist()
    size = (0.85 * width, 0.7 * depth)
    shelves, books = [Shelf((0.0, 0.0), height, size, 0.4)], []
    for low, high in pairwise(levels):
        free = high - low - _BOARD
        floor = low + _BOARD
        if rng.random() < 0.3:
            shelves.append(Shelf((0.0, -0.02), floor, size, 0.85 * free))
        else:
            books.append(_books(rng, width - 2 * _BOARD, depth, floor, free))
    frame = _bookcase_frame(width, depth, height, levels)
    parts = [("bookcase", frame, one_of(rng, ["wood", "paint", "white"]))]
    if books:
        parts.append(("books", shapes.merged(books), "spines"))
    return Piece("bookcase", tuple(parts), (width, depth), height, tuple(shelves))


def _bookcase_frame(
    width: float, depth: float, height: float, levels: list[float]
) -> Mesh:
    """Two sides, a board above each of the levels, and a thin back."""
    boards = []
    for sign in (-1, 1):
        side = (sign * (width - _BOARD) / 2, 0, height / 2)
        boards.append(board((_BOARD, depth, height), side))
    inside = width - 2 * _BOARD
    plank = (inside, depth, _BOARD)
    boards += [board(plank, (0, 0, level + _BOARD / 2)) for level in levels]
    back = (0, depth / 2 - 0.004, height / 2 + 0.02)
    boards.append(board((inside, 0.008, height - 0.05), back))
    return shapes.merged(boards)


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
    """A low cupboard of 0.9 to 1.7 m with rows of doors or drawers."""
    width = rng.uniform(0.9, 1.7)
    depth = rng.uniform(0.38, 0.46)
    height = rng.uniform(0.6, 0.9)
    middle = (0, 0, 0.5 * (height + _FOOT))
    body = board((width, depth, height - _FOOT), middle, 0.012)
    columns, rows = int(rng.integers(2, 5)), int(rng.integers(1, 4))
    doors, knobs = _doors(width, depth, height, columns, rows)
    material = one_of(rng, ["wood", "paint", "white"])
    of_doors = one_of(rng, [material, material, "paint"])
    rounded = rng.random() < 0.5
    feet = _legs(0.94 * width, 0.86 * depth, _FOOT, 0.045, 0.0, rounded)
    parts = (
        ("sideboard", body, material),
        ("doors", doors, of_doors),
        ("knobs", knobs, "metal"),
        ("feet", feet, "wood"),
    )
    top = Shelf((0, 0.02), height, (0.9 * width, 0.75 * depth), 0.6)
    return Piece("sideboard", parts, (width, depth + 0.06), height, (top,))


def _doors(
    width: float, depth: float, height: float, columns: int, rows: int
) -> tuple[Mesh, Mesh]:
    """The doors of a sideboard in columns and rows, and a knob on each."""
    w = (width - 0.04) / columns
    h = (height - _FOOT - 0.05) / rows
    doors, knobs = [], []
    for column, row in product(range(columns), range(rows)):
        x = (column - (columns - 1) / 2) * w
        z = _FOOT + 0.025 + (row + 0.5) * h
        front = (x, -depth / 2 - 0.008, z)
        doors.append(board((w - 0.014, 0.02, h - 0.014), front, 0.005))
        base = [x, -depth / 2 - 0.015, z]
        end = [x, -depth / 2 - 0.045, z]
        knobs.append(rod(base, end, 0.013))
    return shapes.merged(doors), shapes.merged(knobs)


def _plant(rng: Rng) -> Piece:
    """A pot with 14 to 27 long leaves that droop."""
    radius, tall = rng.uniform(0.13, 0.2), rng.uniform(0.24, 0.36)
    count = int(rng.integers(14, 28))
    long = rng.uniform(0.45, 0.8)
    wide = rng.uniform(0.05, 0.12)
    leaves = [_leaf(rng, long, wide, tall - 0.03) for _ in range(count)]
    parts = (
        ("pot", _pot(radius, tall), "glaze"),
        ("leaves", shapes.merged(leaves), "leaf"),
    )
    return Piece("plant", parts, (0.8 * long, 0.8 * long), tall + 0.9 * long)


def _pot(radius: float, tall: float) -> Mesh:
    """A pot that is filled to just below its rim; points that are written twice make hard edges."""
    foot, inside = 0.75 * radius, 0.88 * radius
    outside = [(0, 0), (foot, 0), (foot, 0), (radius, tall), (radius, tall)]
    rim = [(inside, tall), (inside, tall)]
    filling = [(0.85 * radius, tall - 0.04), (0, tall - 0.03)]
    return shapes.lathe(np.array([*outside, *rim, *filling]), 40, smooth=False)


def _leaf(rng: Rng, long: float, wide: float, base: float) -> Mesh:
    """A leaf of three rows of vertices, its ridge below its edges, that rises from z = `base` and droops."""
    turn = rng.uniform(0, 2 * math.pi)
    rise = rng.uniform(0.6, 1.35)
    droop = rng.uniform(0.6, 1.8)
    long *= rng.uniform(0.6, 1.0)
    t = np.linspace(0, 1, _LEAF_STEPS + 1)
    out, up = _ridge(rise - droop * t**1.5, long)
    ridge = np.stack([out * math.cos(turn), out * math.sin(turn), base + up], axis=-1)

    half = wide * np.sin(np.pi * np.clip(0.08 + 0.92 * t, 0, 1)) ** 0.8
    across = np.array([-math.sin(turn), math.cos(turn), 0.0])
    rows = np.array([-1.0, 0.0, 1.0])
    points = ridge[:, None] + half[:, None, None] * rows[:, None] * across
    points[:, 1, 2] -= 0.25 * half
    vertices = points.reshape(-1, 3)
    faces = shapes.grid(3, _LEAF_STEPS + 1)

    u, v = np.broadcast_arrays(np.array([0.0, 0.5, 1.0]) * 0.2, t[:, None])
    uv = np.stack([u, v], axis=-1).reshape(-1, 2)
    tangent = np.gradient(ridge, axis=0)
    normal = np.cross(np.broadcast_to(across, tangent.shape), tangent)
    normal = -normal / np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.repeat(normal, 3, axis=0)
    # The faces turn to the side of the normals.
    if shapes.face_cross(vertices, faces).sum(axis=0) @ normal.sum(axis=0) < 0:
        faces = faces[:, ::-1]
    return double_sided(vertices, faces, normal, uv, 1e-4)


def _ridge(slope: Float, long: float) -> tuple[Float, Float]:
    """How far out and up a line of this length is after steps of equal length, at angles (N,) above the horizon."""
    step = long / _LEAF_STEPS
    out = np.cumsum(np.cos(slope[:-1]))
    up = np.cumsum(np.sin(slope[:-1]))
    return np.concatenate([[0], out]) * step, np.concatenate([[0], up]) * step


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
