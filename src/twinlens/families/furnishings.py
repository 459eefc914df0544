"""Bookcases, sideboards, plants, lamps and boxes, and the lists of what stands where in a room. See `furniture`."""

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np

from twinlens.families.furniture import (
    Piece,
    Rng,
    Shelf,
    armchair,
    board,
    chair,
    coffee_table,
    dining_table,
    legs,
    rod,
    side_table,
    sofa,
    stool,
)
from twinlens.scenes import shapes
from twinlens.scenes.placement import translation
from twinlens.scenes.scene import Mesh


def bookcase(rng: Rng) -> Piece:
    """Boards with rows of books, some bays left for other things."""
    width, height, depth, thick = rng.uniform(0.7, 1.3), rng.uniform(1.2, 2.1), rng.uniform(0.28, 0.34), 0.025
    count = max(3, round(height / 0.36))
    levels = np.linspace(0.05, height - thick, count + 1)
    boards = [board((thick, depth, height), (s * (width - thick) / 2, 0, height / 2)) for s in (-1, 1)]
    boards += [board((width - 2 * thick, depth, thick), (0, 0, float(z) + thick / 2)) for z in levels]
    boards.append(board((width - 2 * thick, 0.008, height - 0.05), (0, depth / 2 - 0.004, height / 2 + 0.02)))
    shelves, books = [Shelf((0.0, 0.0), height, (0.85 * width, 0.7 * depth), 0.4)], []
    for low, high in pairwise(levels):
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
    "box": parcel,
    "plant": plant,
}
