"""Things of thin sheets and boards: cloth in folds, leaning books, toys of blocks."""

import math

import numpy as np

from twinlens.families.draws import Rng, one_of
from twinlens.families.furniture import Piece, board
from twinlens.families.things.pieces import Part, standing
from twinlens.families.things.sweeps import sheet, tube
from twinlens.scenes import shapes
from twinlens.scenes.placement import rotation, translation
from twinlens.scenes.scene import Mesh

_GAP = 0.0005  # metres between books, so that no two surfaces coincide


def hung_cloth(rng: Rng) -> Piece:
    """A cloth of 0.5 to 1.6 m that hangs from a rod between two posts, in folds that deepen downwards."""
    wide, tall = rng.uniform(0.5, 1.2), rng.uniform(0.6, 1.4)
    columns = np.linspace(-wide / 2, wide / 2, 120)
    rows = np.linspace(0.06, tall, 14)
    x, z = np.meshgrid(columns, rows)
    folds, phase = wide * rng.uniform(5, 12), rng.uniform(0, 6)
    down = 1 - z / tall
    # The folds wander a little to a side on their way down.
    wave = np.sin(2 * math.pi * folds * x / wide + phase + 0.8 * np.sin(3 * down))
    depth = 0.012 + rng.uniform(0.015, 0.045) * down
    cloth = sheet(np.stack([x, depth * wave, z], axis=-1), 0.0016)
    rack = _rack(wide / 2 + 0.06, tall)
    return standing(
        "hung-cloth",
        Part("cloth", cloth, one_of(rng, ["fabric", "pattern"])),
        Part("rod", rack, one_of(rng, ["wood", "metal"])),
    )


def _rack(half: float, tall: float) -> Mesh:
    """A level rod at a height between two posts with feet, at x = -half and x = half."""
    bars = [tube([[-half, 0, tall], [half, 0, tall]], 0.012, 12)]
    for x in (-half, half):
        bars.append(tube([[x, 0, 0], [x, 0, tall + 0.02]], 0.012, 12))
        bars.append(tube([[x, -0.18, 0.012], [x, 0.18, 0.012]], 0.012, 12))
    return shapes.merged(bars)


def leaning_books(rng: Rng) -> Piece:
    """Three to nine books: some upright, the others leaning on them, side by side."""
    upright, leaning = int(rng.integers(1, 4)), int(rng.integers(2, 7))
    books = [*_upright_books(rng, upright), *_leaning_books(rng, leaning)]
    parts = []
    for number, book in enumerate(books):
        low = float(book.vertices[:, 2].min())
        on_ground = shapes.transformed(book, translation([0, 0, -low]))
        parts.append(
            Part(f"book-{number}", on_ground, "toy" if number % 2 else "pattern")
        )
    return standing("leaning-books", *parts)


def _upright_books(rng: Rng, count: int) -> list[Mesh]:
    """Books side by side, from x = 0 towards -x."""
    x, books = 0.0, []
    for _ in range(count):
        thick, tall = rng.uniform(0.02, 0.045), rng.uniform(0.2, 0.3)
        deep = rng.uniform(0.13, 0.2)
        books.append(board((thick, deep, tall), (-thick / 2 - x, 0, tall / 2), 0.002))
        x += thick + _GAP
    return books


def _leaning_books(rng: Rng, count: int) -> list[Mesh]:
    """Books side by side towards +x that lean at one angle; the first one touches what ends at x = 0."""
    angle_deg = rng.uniform(8, 24)
    lean = math.radians(angle_deg)
    x, books = _GAP, []
    for number in range(count):
        thick, tall = rng.uniform(0.015, 0.035), rng.uniform(0.15, 0.185)
        deep = rng.uniform(0.11, 0.17)
        # Turned about its lower outer edge; its upper edge touches what is on its left.
        place = x + tall * math.sin(lean) if number == 0 else x
        pose = translation([place, 0, 0]) @ rotation([0, 1, 0], -angle_deg)
        book = board((thick, deep, tall), (thick / 2, 0, tall / 2), 0.002)
        books.append(shapes.transformed(book, pose))
        x = place + (thick + _GAP) / math.cos(lean)
    return books


def toy_wagon(rng: Rng) -> Piece:
    """A toy of blocks: a wagon with wheels, and a row of blocks and rods on it."""
    long, wide = rng.uniform(0.14, 0.26), rng.uniform(0.06, 0.1)
    radius = rng.uniform(0.016, 0.026)
    floor = 1.4 * radius
    bed = board((long, wide, 0.018), (0, 0, floor), 0.004)
    wheels = _wheels_of_toy(0.33 * long, wide / 2, radius)
    load = _load(rng, long, floor + 0.0092)
    return standing(
        "toy-wagon", Part("bed", bed, "wood"), Part("wheels", wheels, "toy"), *load
    )


def _wheels_of_toy(axle: float, half_wide: float, radius: float) -> Mesh:
    """Two axles at x = -axle and x = axle, with a wheel at each end."""
    parts = []
    for x in (-axle, axle):
        end = half_wide + 0.02
        parts.append(tube([[x, -end, radius], [x, end, radius]], 0.003, 8))
        for side in (-1, 1):
            near, far = side * (half_wide + 0.004), side * (half_wide + 0.014)
            parts.append(tube([[x, near, radius], [x, far, radius]], radius, 24))
    return shapes.merged(parts)


def _load(rng: Rng, long: float, top: float) -> list[Part]:
    """Three to five blocks and rods in a row on a bed of this length, whose top is at z = `top`."""
    count = int(rng.integers(3, 6))
    edge = 0.7 * long / count
    parts = []
    for number in range(count):
        x = ((number + 0.5) / count - 0.5) * 0.9 * long
        tall = rng.uniform(0.03, 0.11)
        if rng.random() < 0.5:
            body = tube([[x, 0, top], [x, 0, top + tall]], edge / 2, 20)
        else:
            body = board((edge, edge, tall), (x, 0, top + tall / 2), 0.003)
        parts.append(Part(f"load-{number}", body, "toy"))
    return parts
